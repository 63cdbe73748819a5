"""`camber certs`: an authority, what it issues, what it refuses; keys are for their owner alone."""

from __future__ import annotations

import json
import stat
import threading
from datetime import UTC, datetime, timedelta
from ipaddress import IPv4Address
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID
from cryptography.x509.verification import PolicyBuilder, Store

from camber.runtime.session import router_endpoints
from camber.runtime.tls_certificates import check_table
from camber.tools.security import access, certificate_command
from camber.tools.security.certificate_authority import (
    Authority,
    IssuedCertificate,
    common_name,
    read_certificate,
)
from support.refusals import Refused


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "pki"
    arguments = ["make", str(made), "--host", "cloud.example", "--host", "10.0.0.1", "--days", "20"]
    arguments += ["--vehicle", "car-1", "--vehicle", "car-2", "--consumer", "dashboard"]
    assert certificate_command.main(arguments) == 0
    return made


def revoke(folder: Path, name: str) -> None:
    assert certificate_command.main(["revoke", str(folder), name]) == 0


def issue(folder: Path, name: str, kind: str = "vehicle", *more: str) -> None:
    assert certificate_command.main(["issue", str(folder), name, "--kind", kind, *more]) == 0


def vehicles_in(folder: Path, out: Path) -> set[str]:
    """Common names as `camber access cloud` lists them."""
    assert access.main(["cloud", "--certs", str(folder), "--out", str(out)]) == 0
    listed = {name for names in subjects_in(out) for name in names}
    return listed & {row.common_name for row in Authority(folder).issued() if row.kind == "vehicle"}


def test_a_certificate_says_who_it_is_and_what_it_is_for_and_its_key_is_its_owner_s(folder: Path) -> None:
    authority = read_certificate(folder / "ca.pem")
    for name in ("cloud", "map_update", "car-1", "car-2", "dashboard"):
        certificate = read_certificate(folder / f"{name}.pem")
        assert common_name(certificate.subject) == name
        certificate.verify_directly_issued_by(authority)
        constraints = certificate.extensions.get_extension_for_class(x509.BasicConstraints).value
        assert not constraints.ca, "nobody but the authority signs"
        usage = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        assert (ExtendedKeyUsageOID.SERVER_AUTH in usage) == (name == "cloud"), "only a router can be joined"
    keys = sorted(folder.glob("*.key"))
    assert len(keys) == 6
    assert {stat.S_IMODE(key.stat().st_mode) for key in keys} == {0o600}


def test_strict_verifiers_take_them(folder: Path) -> None:
    store = Store([read_certificate(folder / "ca.pem")])
    for name in ("cloud", "car-1"):
        verified = PolicyBuilder().store(store).build_client_verifier()
        chain = verified.verify(read_certificate(folder / f"{name}.pem"), [])
        assert len(chain.chain) == 2
    server = PolicyBuilder().store(store).build_server_verifier(x509.DNSName("cloud.example"))
    assert server.verify(read_certificate(folder / "cloud.pem"), [])


def test_nothing_is_overwritten(folder: Path, refused: Refused) -> None:
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert "ca.key: there is one already" in refused(certificate_command.main, "make", folder, "--host", "x")
    assert "--renew" in refused(certificate_command.main, "issue", folder, "car-1", "--kind", "vehicle")
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_a_renewed_certificate_has_the_same_name_and_a_new_key(folder: Path) -> None:
    before = (folder / "car-1.key").read_bytes(), read_certificate(folder / "car-1.pem")
    issue(folder, "car-1", "vehicle", "--renew", "--days", "29")
    after = read_certificate(folder / "car-1.pem")
    assert (folder / "car-1.key").read_bytes() != before[0]
    assert after.subject == before[1].subject
    assert after.not_valid_after_utc > before[1].not_valid_after_utc


def hosts_in(folder: Path) -> list[object]:
    """Host names and addresses at which the router is reached, as its certificate has them."""
    extensions = read_certificate(folder / "cloud.pem").extensions
    return [name.value for name in extensions.get_extension_for_class(x509.SubjectAlternativeName).value]


def test_a_renewed_router_is_reached_at_the_same_places_or_at_those_that_are_named(folder: Path) -> None:
    issue(folder, "cloud", "router", "--renew")
    assert hosts_in(folder) == ["cloud.example", IPv4Address("10.0.0.1")]
    issue(folder, "cloud", "router", "--renew", "--host", "elsewhere.example")
    assert hosts_in(folder) == ["elsewhere.example"]


def test_what_is_revoked_is_in_no_access_list_and_its_common_name_never_comes_back(
    folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "cloud.json5"
    assert vehicles_in(folder, out) == {"car-1", "car-2"}
    revoke(folder, "car-1")
    assert vehicles_in(folder, out) == {"car-2"}
    issue(folder, "car-1")
    assert common_name(read_certificate(folder / "car-1.pem").subject) == "car-1+2"
    assert vehicles_in(folder, out) == {"car-1+2", "car-2"}
    # The vehicle keeps its name, and so its keys.
    assert "camber/v1/car-1/integrity/verdict" in out.read_text()
    revoke(folder, "car-1")
    issue(folder, "car-1")
    assert common_name(read_certificate(folder / "car-1.pem").subject) == "car-1+3"


def subjects_in(out: Path) -> list[str]:
    text = "\n".join(line for line in out.read_text().splitlines() if not line.startswith("//"))
    return [subject["cert_common_names"] for subject in json.loads(text)["access_control"]["subjects"]]


def test_map_update_is_revoked_like_all_others(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "cloud.json5"
    arguments = ["cloud", "--certs", str(folder), "--out", str(out)]
    revoke(folder, "map_update")
    assert access.main(arguments) == 0
    assert ["map_update"] not in subjects_in(out)
    issue(folder, "map_update", "map_update")
    assert access.main(arguments) == 0
    assert ["map_update"] not in subjects_in(out)
    assert ["map_update+2"] in subjects_in(out)


@pytest.mark.parametrize("more", [[], ["--router", "cloud"]], ids=["of the folder", "by name"])
def test_a_router_that_was_revoked_and_issued_anew_is_given_its_file(
    folder: Path, tmp_path: Path, more: list[str]
) -> None:
    out = tmp_path / "cloud.json5"
    revoke(folder, "cloud")
    issue(folder, "cloud", "router", "--host", "cloud.example")
    arguments = ["cloud", "--certs", str(folder), "--tls", str(folder), "--out", str(out), *more]
    assert access.main(arguments) == 0
    assert subjects_in(out)[0] == ["cloud+2"]
    _, _, table = router_endpoints(out)
    assert Path(table["listen_certificate"]) == folder / "cloud.pem"
    check_table(table)


@pytest.mark.parametrize("more", [[], ["--router", "cloud"], ["--router", "x", "--vehicle", "car-1"]])
def test_a_revoked_name_cannot_be_listed_by_hand(
    folder: Path, tmp_path: Path, more: list[str], refused: Refused
) -> None:
    for name in ("cloud", "car-1"):
        revoke(folder, name)
    out = tmp_path / "cloud.json5"
    assert "revoked in" in refused(access.main, "cloud", "--certs", folder, "--out", out, *more)
    assert not out.exists()


def test_show_says_who_by_whom_until_when(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert certificate_command.main(["show", str(folder / "cloud.pem"), str(folder / "ca.pem")]) == 0
    output = capsys.readouterr().out
    assert "who    cloud (client and server)" in output
    assert "by     Camber development" in output
    assert "19 days left" in output
    assert "hosts  cloud.example, 10.0.0.1" in output
    assert "(an authority)" in output


def test_show_and_list_say_what_has_expired(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    past = datetime.now(UTC) - timedelta(days=3)
    Authority(folder).issue("late", "vehicle", days=1, now=past)
    assert certificate_command.main(["show", str(folder / "late.pem")]) == 1
    assert "EXPIRED" in capsys.readouterr().out
    assert certificate_command.main(["list", str(folder)]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert listed[1].split()[:4] == ["ca", "authority", "Camber", "development"]
    assert "EXPIRED" not in listed[1]
    assert "EXPIRED" in listed[-1]


def test_a_certificate_does_not_outlive_its_authority(tmp_path: Path) -> None:
    now = datetime.now(UTC)
    authority = Authority.make(tmp_path, name="brief", days=2, now=now)
    authority.issue("car-1", "vehicle", days=30, now=now)
    end = read_certificate(tmp_path / "ca.pem").not_valid_after_utc
    assert read_certificate(tmp_path / "car-1.pem").not_valid_after_utc <= end


def test_an_authority_that_has_expired_signs_nothing(tmp_path: Path, refused: Refused) -> None:
    Authority.make(tmp_path, name="over", days=1, now=datetime.now(UTC) - timedelta(days=2))
    assert "ca.pem: expired" in refused(
        certificate_command.main, "issue", tmp_path, "car-1", "--kind", "vehicle"
    )
    assert Authority(tmp_path).issued() == []


@pytest.mark.parametrize("end", ["key", "pem"])
def test_what_was_not_written_is_not_listed(folder: Path, end: str) -> None:
    (folder / f"car-3.{end}").write_text("somebody else's")
    assert certificate_command.main(["issue", str(folder), "car-3", "--kind", "vehicle"]) == 2
    assert "car-3" not in {row.name for row in Authority(folder).issued()}
    assert (folder / f"car-3.{end}").read_text() == "somebody else's"


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["issue", "car 3", "--kind", "vehicle"], "not a name"),
        (["issue", "fleet", "--kind", "vehicle"], "reserved"),
        (["issue", "car-1+2", "--kind", "vehicle"], "reserved"),
        (["issue", "edge", "--kind", "router"], "needs the host names"),
        (["issue", "car-1", "--kind", "consumer"], "was issued as vehicle"),
        (["issue", "c" * 61, "--kind", "vehicle"], "61 characters, expected at most 60"),
        *(
            (["issue", "edge", "--kind", "router", "--host", host], f"host '{host}': expected")
            for host in ("wölkchen.example", "", "10.0.0.1/24", "10.0.0.256", "[::1]", "a..b")
        ),
        (["revoke", "car-9"], "no valid certificate"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_what_cannot_be_done_is_one_line(
    folder: Path, arguments: list[str], why: str, refused: Refused
) -> None:
    assert why in refused(certificate_command.main, arguments[0], folder, *arguments[1:])


def test_no_key_is_ever_printed(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = [path.read_text().splitlines()[1] for path in folder.glob("*.key")]
    certificate_command.main(["show", str(folder / "car-1.key")])
    certificate_command.main(["show", *map(str, folder.glob("*.pem"))])
    certificate_command.main(["list", str(folder)])
    output = capsys.readouterr()
    assert "car-1.key: not a certificate in PEM" in output.err
    assert not [line for line in lines if line in output.out + output.err]


def test_hosts_are_names_and_addresses(tmp_path: Path) -> None:
    hosts = ["localhost", "map_update", "cloud.example", "*.cloud.example", "xn--wlkchen-b1a.example"]
    hosts += ["::1", "7.b"]
    arguments = [argument for host in hosts for argument in ("--host", host)]
    assert certificate_command.main(["make", str(tmp_path / "pki"), *arguments]) == 0
    assert list(map(str, hosts_in(tmp_path / "pki"))) == hosts


def test_a_name_of_the_greatest_length_can_be_revoked_and_issued_anew(folder: Path) -> None:
    for _ in range(3):
        issue(folder, "c" * 60)
        revoke(folder, "c" * 60)


def test_a_longer_name_of_earlier_days_can_be_renewed_and_once_revoked_is_one_line(
    folder: Path, refused: Refused
) -> None:
    name, until = "c" * 64, "2030-01-01T00:00:00+00:00"
    row = IssuedCertificate(name=name, kind="vehicle", common_name=name, serial="1", until=until)
    Authority(folder)._save([*Authority(folder).issued(), row])
    issue(folder, name, "vehicle", "--renew")
    revoke(folder, name)
    line = refused(certificate_command.main, "issue", folder, name, "--kind", "vehicle")
    assert line == f"camber certs: {name}: 64 characters, expected at most 60"


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--vehicle", "car 1"], "not a name"),
        (["--vehicle", "c" * 61], "61 characters"),
        (["--consumer", "cloud"], "cloud: named twice"),
        (["--vehicle", "a", "--judge", "a"], "a: named twice"),
        (["--host", "10.0.0.1/24"], "host '10.0.0.1/24'"),
        (["--name", ""], "expected a name of 1 to 60 characters"),
        (["--name", "n" * 65], "expected a name of 1 to 60 characters"),
    ],
    ids=lambda value: " ".join(value)[:20] if isinstance(value, list) else "",
)
def test_no_half_of_an_authority_is_made(
    tmp_path: Path, arguments: list[str], why: str, refused: Refused
) -> None:
    assert why in refused(
        certificate_command.main, "make", tmp_path / "pki", "--host", "cloud.example", *arguments
    )
    assert not (tmp_path / "pki").exists()


def test_a_revocation_meanwhile_is_not_undone_and_no_certificate_is_lost(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that issues has read the list and is held up, while others revoke and issue."""
    signer, reading, go_on = Authority._signer, threading.Event(), threading.Event()

    def held_up(self: Authority) -> object:
        if not reading.is_set():
            reading.set()
            go_on.wait(30.0)
        return signer(self)

    monkeypatch.setattr(Authority, "_signer", held_up)
    first = threading.Thread(target=issue, args=(folder, "car-3"))
    first.start()
    assert reading.wait(30.0)
    others = ((revoke, "car-1"), (issue, "car-4"))
    threads = [threading.Thread(target=work, args=(folder, name)) for work, name in others]
    for thread in threads:
        thread.start()
        thread.join(0.5)  # time enough for a thread that does not wait
    go_on.set()
    for thread in (first, *threads):
        thread.join(30.0)
    rows = {row.name: row for row in Authority(folder).issued()}
    assert rows["car-1"].revoked is not None
    assert {"car-3", "car-4"} <= set(rows)


@pytest.mark.parametrize("at", ["issued.json.new", "car-1.key.new", "car-1.pem.new"])
def test_a_renewal_that_was_interrupted_leaves_a_pair_or_is_finished_by_the_next_run(
    folder: Path, at: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = (folder / "car-1.pem").read_bytes()
    replace = Path.replace

    def cut(self: Path, target: Path) -> Path:
        if self.name == at:
            raise KeyboardInterrupt
        return replace(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", cut)
        with pytest.raises(KeyboardInterrupt):
            certificate_command.main(
                ["issue", str(folder), "car-1", "--kind", "vehicle", "--renew", "--days", "29"]
            )
    issue(folder, "car-5")
    key = load_pem_private_key((folder / "car-1.key").read_bytes(), password=None)
    assert key.public_key() == read_certificate(folder / "car-1.pem").public_key()
    assert ((folder / "car-1.pem").read_bytes() == before) == (at != "car-1.pem.new")
    assert not list(folder.glob("*.pem.new")) + list(folder.glob("*.key.new"))


def test_no_lock_is_left_in_a_folder_that_is_no_authority_s(tmp_path: Path) -> None:
    assert certificate_command.main(["revoke", str(tmp_path), "car-1"]) == 2
    assert certificate_command.main(["issue", str(tmp_path), "car-1", "--kind", "vehicle"]) == 2
    assert list(tmp_path.iterdir()) == []
