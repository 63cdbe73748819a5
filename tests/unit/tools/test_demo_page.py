"""`camber demo --open`: the replay ends on a live page."""

from __future__ import annotations

from pathlib import Path

import pytest

from camber.tools import demo


@pytest.mark.parametrize(("code", "shown"), [(0, True), (1, False)])
def test_the_page_is_shown_of_a_replay_that_went_well(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, shown: bool
) -> None:
    pages: list[list[str]] = []

    def live(arguments: list[str]) -> int:
        pages.append(arguments)
        return 0

    monkeypatch.setattr("camber.live.command.main", live)
    monkeypatch.setattr(demo, "replay", lambda *_, **__: code)
    assert demo.main(["--short", "--open", "--out", str(tmp_path)]) == code
    assert pages == ([[str(tmp_path), "--open"]] if shown else [])
