"""What is compiled is compiled before the first input comes, and not while a vehicle drives."""

import subprocess
import sys

import pytest

from support.running import environment


@pytest.mark.slow
@pytest.mark.parametrize("service", ["gnss", "localizer", "map_server", "map_update"])
def test_the_warm_up_of_a_service_calls_all_that_it_calls(service: str) -> None:
    command = [sys.executable, "-m", "support.compiled_calls", service]
    done = subprocess.run(
        command, env=environment(), capture_output=True, text=True, timeout=300.0, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
