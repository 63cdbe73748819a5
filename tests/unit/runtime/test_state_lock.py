"""One process for each service and folder of state."""

from __future__ import annotations

from pathlib import Path

import pytest

from camber.runtime.state_lock import FolderInUseError, locked
from support.running import camber, settings_file, started


def test_a_second_one_of_the_service_is_refused_and_another_service_is_not(tmp_path: Path) -> None:
    with locked(tmp_path / "state", "integrity"):
        with (
            pytest.raises(FolderInUseError, match=rf"^{tmp_path}/state: another integrity uses this folder"),
            locked(tmp_path / "state", "integrity"),
        ):
            raise AssertionError("both work")
        with locked(tmp_path / "state", "localizer"):
            pass
    with locked(tmp_path / "state", "integrity"):
        pass


def test_where_nothing_can_be_written_there_is_no_lock(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with locked(tmp_path / "file", "integrity"), locked(None, "integrity"):
        pass


_HOLDER = """
import sys, time
from pathlib import Path
from camber.runtime.state_lock import locked
with locked(Path(sys.argv[1]), "antenna_height"):
    print("holds it", flush=True)
    time.sleep(60.0)
"""


def test_the_second_process_ends_with_one_line_that_names_the_folder_and_a_killed_one_holds_nothing(
    tmp_path: Path,
) -> None:
    state = tmp_path / "state"
    config = settings_file(tmp_path / "height.toml", "tcp/127.0.0.1:9", f'state_dir = "{state}"')
    with started("-c", _HOLDER, state) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "holds it\n"
        ended = camber("antenna_height", "--config", config)
        assert ended.returncode == 2
        assert ended.stderr == (
            f"camber antenna_height: {state}: another antenna_height uses this folder, expected one of its own\n"
        )
        holder.kill()
        holder.wait()
    with locked(state, "antenna_height"):
        pass
