"""The table of channels agrees with itself."""

from __future__ import annotations

import pytest

from camber.schemas.channels import BY_NAME, CHANNELS, SERVICES, Channel, inputs_of, outputs_of

every_channel = pytest.mark.parametrize("channel", CHANNELS, ids=lambda channel: channel.name)
OTHERS = {"vehicle", "tools", "feeder", "consumers", "sensors", "ros2"}


def test_names_and_keys_are_unique() -> None:
    assert len(BY_NAME) == len(CHANNELS) == len({channel.key for channel in CHANNELS})


@every_channel
def test_a_key_has_the_form_of_the_architecture(channel: Channel) -> None:
    version, kind = channel.key.split("/", 2)[:2], channel.key.split("/", 2)[2]
    assert version == ["camber", "v1"]
    assert kind.startswith(("{vehicle}/", "fleet/"))
    assert "{vehicle}" not in channel.key_for("car_1")
    assert "*" not in channel.key


@every_channel
def test_ends_are_services_or_known_others(channel: Channel) -> None:
    assert set(channel.producers) | set(channel.consumers) <= {*SERVICES, *OTHERS}
    assert channel.producers


@every_channel
def test_only_what_is_asked_has_a_reply(channel: Channel) -> None:
    assert (channel.reply is not None) == (channel.delivery in ("query", "upload", "fetch"))


@every_channel
def test_what_is_judged_by_age_says_which(channel: Channel) -> None:
    if channel.delivery in ("small", "bulk") and channel.consumers and channel.rate_hz is not None:
        assert channel.max_age_s is not None
        assert channel.max_age_s >= 1 / channel.rate_hz


def test_within_an_epoch_data_flow_forward_but_for_the_loops() -> None:
    order = {service: place for place, service in enumerate(SERVICES)}
    for channel in CHANNELS:
        if channel.delivery in ("small", "bulk") and channel.key.startswith("camber/v1/{vehicle}/"):
            for producer in order.keys() & set(channel.producers):
                later = {c for c in order.keys() & set(channel.consumers) if order[c] > order[producer]}
                looped = {c for c in order.keys() & set(channel.consumers) if order[c] < order[producer]}
                assert not looped or channel.looped, f"{channel.name} runs back from {producer} to {looped}"
                assert later or looped or channel.consumers in ((), ("consumers",))


def test_inputs_and_outputs_of_the_judge() -> None:
    assert {"fix", "pose", "antenna_height"} <= {channel.name for channel in inputs_of("integrity")}
    assert {channel.name for channel in outputs_of("integrity")} == {"verdict", "position"}
