"""What is compiled is compiled before the first input comes, and not while a vehicle drives."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.running import python

COUNT = """
from camber.compiled.compilation_progress import CompilationProgress, watched_by
progress = CompilationProgress(expected=None, begin=lambda functions: None, advance=lambda: None)
with watched_by(progress):
    {work}
print(progress.read + progress.compiled)
"""


@pytest.mark.slow
@pytest.mark.parametrize("service", ["gnss", "localizer", "map_server", "map_update"])
def test_the_warm_up_of_a_service_calls_all_that_it_calls(service: str) -> None:
    done = python("-m", "support.compiled_calls", service, timeout_s=300.0)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("names", "work"),
    [
        ("READER_FUNCTIONS", "compile_readers()"),
        ("ENGINE_FUNCTIONS", "warm_up(subsets=False)"),
        ("ENGINE_FUNCTIONS + SUBSET_FUNCTIONS", "warm_up()"),
        ("ENGINE_FUNCTIONS + SUBSET_FUNCTIONS + CARRIED_FUNCTIONS", "warm_up(carried=True)"),
    ],
)
def test_the_engine_counts_the_functions_of_each_use(names: str, work: str) -> None:
    script = f"from camber.gnss.warm_up import *\n{COUNT.format(work=work)}print({names})"
    counted, stated = python("-c", script, timeout_s=300.0).stdout.split()
    assert counted == stated


@pytest.mark.slow
def test_commands_count_the_functions_they_use(tmp_path: Path) -> None:
    """The city, its raw observations and its replay; what a replay reads besides is counted by nobody."""
    overrides = '["duration_s=0.5", "lidar.beams=32"]'
    work = f'simulate(load_scenario("city", {overrides}), Path("{tmp_path}/city"), quiet=True)'
    imports = "from pathlib import Path\nfrom camber.simulator.scenario import load_scenario\n"
    imports += "from camber.tools.simulate import simulate\nfrom camber.tools.demo import CITY_FUNCTIONS\n"
    done = python("-c", f"{imports}{COUNT.format(work=work)}print(CITY_FUNCTIONS)", timeout_s=300.0)
    counted, stated = done.stdout.split()
    assert counted == stated
    imports = "from camber.gnss.warm_up import ENGINE_FUNCTIONS\nfrom camber.tools.gnss import solve\n"
    work = f'solve.main(["{tmp_path}/city/drive.toml", "--out", "{tmp_path}/solve"])'
    script = f"{imports}{COUNT.format(work=work)}print(solve.RINEX_FUNCTIONS + ENGINE_FUNCTIONS)"
    counted, stated = python("-c", script, timeout_s=300.0).stdout.split()[-2:]
    assert counted == stated
