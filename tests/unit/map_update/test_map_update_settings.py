"""Settings of storage and roles: contradictions are refused in one line, and no password is shown."""

import pytest

from camber.map_update.settings import MapUpdateSettings
from camber.runtime.settings import ConfigError, load, to_toml

STORE = "postgresql://camber@db:5432/uploads"
QUEUE = "nats://queue:4222"


def loaded(*arguments):
    return load(MapUpdateSettings, list(arguments), prog="test")[0]


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--store", "mysql://db/uploads"], "store: expected postgresql://user@host:port"),
        (["--store", "postgresql:///uploads"], "store: expected postgresql://user@host:port"),
        (["--store", "postgresql://db:many/uploads"], "store: expected postgresql://user@host:port"),
        (["--queue", "http://queue", "--role", "store"], "queue: expected nats://user@host:port"),
        (["--role", "receive"], "role: "),
        (["--queue", QUEUE], "role: "),
        (["--queue", QUEUE, "--role", "receive", "--shards", '["0","1"]'], "no shard has the tile 2"),
        (["--queue", QUEUE, "--role", "store", "--shard", "3"], "shard: '3', expected one of"),
        (["--shards", '["0","1","2","3"]'], "shards: a worker without a queue has one"),
    ],
)
def test_a_contradiction_is_one_line(arguments, complaint):
    with pytest.raises(ConfigError) as error:
        loaded(*arguments)
    assert complaint in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("option", "address"),
    [
        ("--store", "postgresql://camber:hush@db/uploads"),
        ("--store", "postgresql://camber@db/uploads?password=hush"),
        ("--queue", "nats://camber:hush@queue:4222"),
    ],
)
def test_a_password_in_an_address_is_refused_and_not_repeated(option, address):
    with pytest.raises(ConfigError) as error:
        loaded(option, address, "--role", "store")
    assert "no password in an address" in str(error.value)
    assert f"CAMBER_MAP_UPDATE_{option[2:].upper()}_PASSWORD" in str(error.value)
    assert "hush" not in str(error.value)


def test_passwords_come_from_the_environment_and_are_not_printed(monkeypatch):
    monkeypatch.setenv("CAMBER_MAP_UPDATE_STORE_PASSWORD", "hush")
    monkeypatch.setenv("CAMBER_MAP_UPDATE_QUEUE_PASSWORD", "quiet")
    settings = loaded("--store", STORE, "--queue", QUEUE, "--role", "store")
    assert settings.store_password is not None
    assert settings.store_password.get_secret_value() == "hush"
    assert "hush" not in to_toml(settings) + repr(settings)
    assert "quiet" not in to_toml(settings) + repr(settings)
    with pytest.raises(ConfigError, match="not on the command line"):
        loaded("--store-password", "hush")
