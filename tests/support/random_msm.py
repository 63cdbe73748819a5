"""MSM of RTCM 3 with random fields."""

from __future__ import annotations

import numpy as np

from camber.formats.broadcast.bit_fields import bits_to_bytes, pack_bits
from camber.formats.rtcm.msm_signals import GLONASS_MSM, MSM_SYSTEMS_READ
from camber.formats.rtcm.writer import rtcm_frame


def any_msm(random: np.random.Generator, number: int) -> bytes:
    """A well-formed message with random fields, including the codes of "unknown"."""
    most = next(s.satellites for s in MSM_SYSTEMS_READ if s.message // 10 == number // 10)
    satellites = np.sort(
        random.choice(np.arange(1, most + 1), int(random.integers(0, min(most, 20) + 1)), False)
    )
    signals = np.sort(random.choice(np.arange(1, 33), int(random.integers(1, 4)), False))
    cells = random.random(satellites.size * signals.size) < 0.8
    rates, fine = number % 2 == 1, number % 10 >= 6
    code, phase, lock, cn0 = (20, 24, 10, 10) if fine else (15, 22, 4, 6)
    widths_of_satellites = [8, 4, 10, 14] if rates else [8, 10]
    widths = [code, phase, lock, 1, cn0, *([15] if rates else [])]
    time = int(random.integers(0, 604_800_000))
    if number // 10 == GLONASS_MSM.message // 10:
        time = int(random.integers(0, 8)) << 27 | int(random.integers(0, 86_400_000))
    pairs = [(number, 12), (int(random.integers(0, 4096)), 12), (time, 30)]
    pairs += [(int(random.integers(0, 2)), 1), (0, 18)]
    pairs += [(int(k in satellites), 1) for k in range(1, 65)] + [
        (int(k in signals), 1) for k in range(1, 33)
    ]
    pairs += [(int(cell), 1) for cell in cells]
    counts = [*((w, satellites.size) for w in widths_of_satellites), *((w, cells.sum()) for w in widths)]
    for width, count in counts:
        special = [0, 1 << (width - 1), (1 << width) - 1]
        for _ in range(count):
            value = random.integers(0, 1 << width) if random.random() < 0.9 else random.choice(special)
            pairs.append((int(value), width))
    return rtcm_frame(bits_to_bytes(*pack_bits(pairs)))
