"""`camber lab`: the judge against millions of simulated wrong fixes, faults and right fixes."""

from __future__ import annotations

import argparse
import json
import sys
from functools import partial
from pathlib import Path

from camber.formats.errors import FormatError
from camber.tools.options.error_report import report_failures
from camber.tools.options.number_options import PROCESSES, SEED, whole_from
from camber.tools.options.output_check import check_output_folder
from camber.validation.lab.html_page import lab_html
from camber.validation.lab.page import page
from camber.validation.lab.run import RunSize, run

_PROG = "camber lab"
TRIALS, QUICK_TRIALS = 1_000_000, 4_000


def main(argv: list[str] | None = None) -> int:
    """Run it; returns the exit code."""
    parser = _parser()
    options = parser.parse_args(argv)

    def work() -> int:
        if options.page is None:
            _write(options)
        else:
            print(_page_of(options.page), end="")
        return 0

    return report_failures(_PROG, options.out, work)


def _page_of(path: Path) -> str:
    try:
        return page(json.loads(path.read_text("utf-8")))
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise FormatError(str(path), "figures", "the lab.json of a run", actual=repr(error)) from error


def _write(options: argparse.Namespace) -> None:
    check_output_folder(options.out, "lab.json")
    trials = QUICK_TRIALS if options.quick else options.trials
    options.out.mkdir(parents=True, exist_ok=True)
    print(f"seed {options.seed}, {trials:,} episodes of each kind", file=sys.stderr)
    figures = run(
        RunSize(trials=trials, seed=options.seed), options.processes, partial(print, file=sys.stderr)
    )
    (options.out / "lab.json").write_text(json.dumps(figures, indent=1), "utf-8")
    text = page(figures)
    (options.out / "lab.md").write_text(text, "utf-8")
    (options.out / "lab.html").write_text(lab_html(figures), "utf-8")
    print(text, end="")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=_PROG, description=__doc__.split(":", 1)[1].strip())
    add, each = parser.add_argument, f"episodes of each kind in each headline scene ({TRIALS:,})"
    add(
        "--out",
        type=Path,
        default=Path("out/lab"),
        help="folder of lab.json, lab.md and lab.html, the page with charts",
    )
    add("--trials", type=whole_from(1, 10**9), default=TRIALS, help=each)
    add("--seed", type=SEED, default=1, help="of every draw (1)")
    add("--processes", type=PROCESSES, default=2, help="the figures do not depend on it (2)")
    add("--quick", action="store_true", help=f"{QUICK_TRIALS:,} episodes: seconds, no proof")
    add("--page", type=Path, metavar="LAB_JSON", help="print the page's section of a run and end")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
