"""The page of the data flow describes every channel and message of the table of channels."""

from __future__ import annotations

import pytest

from camber.schemas.channels import CHANNELS
from camber.tools.generate_docs.data_flow import page, unit_of
from support.messages import message_classes


def test_every_channel_has_a_row_with_its_key() -> None:
    rows = [line for line in page().splitlines() if line.startswith("|")]
    for channel in CHANNELS:
        assert sum(f"`{channel.key}`" in row for row in rows) == 1


def test_every_message_is_described_once_with_all_its_fields() -> None:
    text = page()
    for cls in message_classes():
        _, section = text.split(f"### {cls.__name__}\n")
        table = section.split("\n### ")[0]
        for field in cls.model_fields:
            assert table.count(f"| `{field}` |") == 1


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("height_m", "m"),
        ("yaw_rate_rad_s", "rad/s"),
        ("covariance_enu_m2", "m²"),
        ("covariance_enu_m2_s2", "m²/s²"),
        ("velocity_enu_m_s", "m/s"),
        ("time_ns", "ns of GPS time"),
        ("offset_ns", "ns"),
        ("cn0_dbhz", "dB-Hz"),
        ("status", ""),
    ],
)
def test_a_unit_is_what_the_name_ends_in(name: str, unit: str) -> None:
    assert unit_of(name) == unit
