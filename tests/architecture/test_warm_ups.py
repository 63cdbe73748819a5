"""What is compiled is compiled before the first input comes, and not while a vehicle drives."""

import pytest

from support.running import python


@pytest.mark.slow
@pytest.mark.parametrize("service", ["gnss", "localizer", "map_server", "map_update"])
def test_the_warm_up_of_a_service_calls_all_that_it_calls(service: str) -> None:
    done = python("-m", "support.compiled_calls", service, timeout_s=300.0)
    assert done.returncode == 0, done.stdout + done.stderr
