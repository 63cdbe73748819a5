"""A scripted TCP server, and certificates for it."""

from __future__ import annotations

import datetime
import ipaddress
import socket
import ssl
import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

_STEP_S = 0.05

Script = Callable[["Peer"], None]


class Peer:
    """A connection of the server."""

    def __init__(self, connection: socket.socket, stop: threading.Event) -> None:
        self.socket = connection
        self._stop = stop
        self.sentences = b""

    def request(self) -> bytes:
        """Receive all up to the empty line."""
        while b"\r\n\r\n" not in self.sentences:
            self.listen()
        head, end, self.sentences = self.sentences.partition(b"\r\n\r\n")
        return head + end

    def listen(self) -> None:
        """Receive into `sentences` for a moment; ConnectionError where the client has gone."""
        if self._stop.is_set():
            raise ConnectionError("the test is over")
        self.socket.settimeout(_STEP_S)
        try:
            data = self.socket.recv(65_536)
        except TimeoutError:
            return
        if not data:
            raise ConnectionError("the client has gone")
        self.sentences += data

    def say(self, data: bytes) -> None:
        self.socket.settimeout(5.0)
        self.socket.sendall(data)

    def wait(self, seconds: float = 60.0) -> None:
        """Send nothing until the client has gone or the test is over."""
        for _ in range(int(seconds / _STEP_S)):
            self.listen()


class HostileCaster:
    """Runs the first script for the first connection, and so on; the last one for all others."""

    def __init__(self, *scripts: Script, tls: ssl.SSLContext | None = None) -> None:
        self._scripts = scripts
        self._tls = tls
        self._stop = threading.Event()
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._listening.settimeout(_STEP_S)
        self.port = self._listening.getsockname()[1]
        self.connections = 0
        self._threads = [threading.Thread(target=self._accept, name="hostile-caster")]

    def __enter__(self) -> HostileCaster:
        self._threads[0].start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join()
        self._listening.close()

    def _accept(self) -> None:
        while not self._stop.is_set():
            try:
                connection = self._listening.accept()[0]
            except TimeoutError:
                continue
            script = self._scripts[min(self.connections, len(self._scripts) - 1)]
            self.connections += 1
            thread = threading.Thread(target=self._serve, args=(connection, script), name="hostile-caster")
            self._threads.append(thread)
            thread.start()

    def _serve(self, connection: socket.socket, script: Script) -> None:
        try:
            if self._tls is not None:
                connection.settimeout(5.0)
                connection = self._tls.wrap_socket(connection, server_side=True)
            script(Peer(connection, self._stop))
        except OSError:
            pass  # the client has gone, or has refused us
        finally:
            connection.close()


def certificates(folder: Path, name: str, *, address: str | None = None) -> tuple[Path, ssl.SSLContext]:
    """The file of an authority, and the context of a server whose certificate it has signed, for `name`."""
    authority_key, server_key = (ec.generate_private_key(ec.SECP256R1()) for _ in range(2))
    authority = _certificate(f"authority of {name}", authority_key, None, [], None)
    names: list[x509.GeneralName] = [x509.DNSName(name)]
    if address is not None:
        names.append(x509.IPAddress(ipaddress.ip_address(address)))
    server = _certificate(name, server_key, authority, names, authority_key)
    authority_file, server_file = folder / f"{name}.ca.pem", folder / f"{name}.pem"
    pem = serialization.Encoding.PEM
    authority_file.write_bytes(authority.public_bytes(pem))
    server_file.write_bytes(
        server_key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
        + server.public_bytes(pem)
    )
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(server_file)
    return authority_file, context


def _certificate(
    name: str,
    key: ec.EllipticCurvePrivateKey,
    issuer: x509.Certificate | None,
    names: list[x509.GeneralName],
    signing_key: ec.EllipticCurvePrivateKey | None,
) -> x509.Certificate:
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now = datetime.datetime.now(datetime.UTC)
    issuer_key = (signing_key or key).public_key()
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer.subject if issuer else subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(x509.BasicConstraints(ca=issuer is None, path_length=None), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer_key), critical=False)
        .add_extension(_key_usage(authority=issuer is None), critical=True)
    )
    if names:
        builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
    return builder.sign(signing_key or key, hashes.SHA256())


def _key_usage(*, authority: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not authority,
        key_cert_sign=authority,
        crl_sign=authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )
