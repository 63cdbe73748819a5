"""One collection of the tests, and a fork of it for each mutant: `pytest -p forked`, within mutmut's folder.

mutmut collects the tests anew for each mutant, which takes longer than the tests. Here the collection is forked, and
each fork runs the tests that call the changed function up to the first that fails: those that noticed other changes
of it first, then the quickest. What is called while a test module is imported has been called before: so what no test
noticed is tried once more in a process of its own.
"""

from __future__ import annotations

import gc
import json
import os
import signal
import time
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple, NoReturn, TextIO

import pytest

_LONGEST_S = 600.0  # of the clock, on a busy machine; each test has a limit of processor time of its own


class _Fork(NamedTuple):
    mutant: str
    began_s: float
    verdict_file: int
    """Here it says which test noticed, or nothing."""


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("mutation")
    group.addoption("--mutants", type=Path, help="JSON: the tests of each mutant, the quickest first")
    group.addoption(
        "--verdicts", type=Path, help="file to write: a JSON array [mutant, noticed] on each line"
    )
    group.addoption("--at-once", type=int, default=1, help="forks at a time")


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> bool:
    """In place of running each test once."""
    options = session.config.option
    items = {item.nodeid: item for item in session.items}
    running: dict[int, _Fork] = {}
    noticing: dict[str, list[str]] = defaultdict(list)
    gc.freeze()  # or each fork copies what the collector touches
    with options.verdicts.open("w") as verdicts:
        for mutant, tests in json.loads(options.mutants.read_text()).items():
            while len(running) >= options.at_once:
                _wait(running, noticing, verdicts)
            before = [test for test in noticing[_function(mutant)] if test in tests]
            names = dict.fromkeys([*before, *tests])
            pid, fork = _fork(mutant, [items[name] for name in names if name in items], session)
            running[pid] = fork
        while running:
            _wait(running, noticing, verdicts)
    return True


def _function(mutant: str) -> str:
    return mutant.rpartition("__mutmut_")[0]


def _fork(mutant: str, items: list[pytest.Item], session: pytest.Session) -> tuple[int, _Fork]:
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        _run(mutant, items, session, writing)
    os.close(writing)
    return pid, _Fork(mutant, time.monotonic(), reading)


def _wait(running: dict[int, _Fork], noticing: dict[str, list[str]], verdicts: TextIO) -> None:
    """For one fork to end; those that take too long are ended."""
    while True:
        for pid, fork in running.items():
            ended, status = os.waitpid(pid, os.WNOHANG)
            if ended:
                del running[pid]
                _note(fork, status, noticing[_function(fork.mutant)], verdicts)
                return
            if time.monotonic() - fork.began_s > _LONGEST_S:
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.002)


def _note(fork: _Fork, status: int, noticing: list[str], verdicts: TextIO) -> None:
    with os.fdopen(fork.verdict_file) as verdict_file:
        test = verdict_file.read()
    if test:
        if test in noticing:
            noticing.remove(test)
        noticing.insert(0, test)
    verdicts.write(json.dumps([fork.mutant, status != 0]) + "\n")
    verdicts.flush()


def _run(mutant: str, items: list[pytest.Item], session: pytest.Session, verdict_file: int) -> NoReturn:
    """In the fork, which it ends, with 1 where a test failed."""
    from mutmut.mutation.trampoline import set_mutant_under_test

    nothing = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1, 2):
        os.dup2(nothing, number)
    set_mutant_under_test(mutant)
    name = ""
    try:
        for item, following in zip(items, [*items[1:], None], strict=True):
            name = item.nodeid
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if session.testsfailed:
                break
        else:
            os._exit(0)
    except BaseException:
        pass
    os.write(verdict_file, name.encode())
    os._exit(1)
