"""A receiver's UBX over TCP and a base's RTCM through a real caster become right fixes, and again after every fault."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from camber.runtime.subscription import Subscription
from camber.schemas.gnss import Fix, SatelliteVelocity
from support.live_satellites import LiveDrive, LiveGnss, Port, live_gnss, serving
from support.running import free_port, wait_until
from support.streams import rtklib_caster

pytestmark = pytest.mark.timed

DURATION_S = 400.0
PATIENCE_S = 90.0
RIGHT_M = 0.10


class Chain:
    """Receiver, base, caster and gnss; the caster can be put away and set up again."""

    def __init__(self, drive: LiveDrive, rover: Port, base: Port, gnss: LiveGnss, caster_port: int) -> None:
        self.drive, self.rover, self.base, self.gnss = drive, rover, base, gnss
        self._caster_port = caster_port
        self._caster = ExitStack()

    def set_up_caster(self, **options: str) -> None:
        self._caster.close()
        self._caster.enter_context(rtklib_caster(self.base.number, self._caster_port, **options))

    def put_caster_away(self) -> None:
        self._caster.close()

    def until(self, wanted: Callable[[Fix], bool], why: str) -> Fix:
        """The first fix that is wanted; every one before that calls itself fixed must be right as well."""
        with Subscription("fix", vehicle="car", connect=[self.gnss.endpoint]) as listener:

            def wanted_fix() -> Fix | None:
                fix = listener.next(0.5)
                if fix is None:
                    return None
                if fix.quality == "fixed":
                    assert self.drive.error_m(fix) < RIGHT_M
                return fix if wanted(fix) else None

            first: Fix = wait_until(wanted_fix, timeout_s=PATIENCE_S, why=why)
            return first

    def until_fixed(self) -> Fix:
        return self.until(lambda fix: fix.quality == "fixed", f"no fix; {self.gnss.issues()}")

    def until_lost(self, why: str) -> None:
        """Until health says why the base was lost."""
        wait_until(
            lambda: why in self.gnss.issues().get("source_lost", ""),
            timeout_s=PATIENCE_S,
            why=f"{why!r} is not in health",
        )


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chain]:
    folder = tmp_path_factory.mktemp("live")
    drive = LiveDrive(folder / "drive", DURATION_S)
    caster_port = free_port()
    with (
        serving(drive.rover) as rover,
        serving(drive.base) as base,
        live_gnss(folder, rover, caster_port) as gnss,
    ):
        chain = Chain(drive, rover, base, gnss, caster_port)
        chain.set_up_caster()
        try:
            yield chain
        finally:
            chain.put_caster_away()
        assert gnss.process.poll() is None


def test_fixes_and_velocities_come_and_are_right(chain: Chain) -> None:
    chain.until_fixed()
    fixed, velocities = 0, 0
    with Subscription("fix", "velocity", vehicle="car", connect=[chain.gnss.endpoint]) as listener:
        for _ in range(60):
            message = listener.next(10.0)
            if isinstance(message, SatelliteVelocity):
                velocities += 1
                continue
            assert isinstance(message, Fix)
            assert message.origin == "engine"
            if message.quality == "fixed":
                fixed += 1
                assert chain.drive.error_m(message) < RIGHT_M
    assert fixed > 20
    assert velocities > 20
    assert chain.gnss.health().status == "ok"


def test_a_receiver_is_read_again_after_its_line_was_cut(chain: Chain) -> None:
    chain.until_fixed()
    chain.rover.cut()
    chain.until_lost(f"tcp:127.0.0.1:{chain.rover.number}: the other side closed the connection")
    chain.until_fixed()


def test_fixes_stop_until_a_restarted_caster_is_back(chain: Chain) -> None:
    chain.until_fixed()
    chain.put_caster_away()
    chain.until_lost("/BASE: ")
    chain.until(lambda fix: fix.quality == "single", "fixes went on without a base")
    assert "base_stale" in chain.gnss.issues()
    chain.set_up_caster()
    chain.until_fixed()


def test_a_wrong_password_is_named_and_a_right_one_is_enough(chain: Chain) -> None:
    chain.set_up_caster(password="changed")
    chain.until_lost("the caster does not accept user and password (401)")
    chain.set_up_caster()
    chain.until_fixed()


def test_a_slow_caster_makes_corrections_old_and_no_fix_wrong(chain: Chain) -> None:
    chain.base.pause_between_bytes_s = 0.2
    try:
        late = chain.until(
            lambda fix: fix.quality == "fixed" and (fix.age_of_corrections_s or 0.0) >= 1.0,
            "no fix rests on old corrections",
        )
        assert late.age_of_corrections_s is not None
    finally:
        chain.base.pause_between_bytes_s = 0.0
    chain.until(
        lambda fix: fix.quality == "fixed" and (fix.age_of_corrections_s or 0.0) < 1.0,
        "corrections are not fresh again",
    )


def test_a_silent_base_is_named_and_used_again(chain: Chain) -> None:
    chain.base.silent = True
    try:
        chain.until_lost("silent for 2 s")
    finally:
        chain.base.silent = False
    chain.until_fixed()
