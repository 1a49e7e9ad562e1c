"""Why there is no Zenoh session.

Zenoh has one sentence for all causes: "Unable to connect". So each endpoint is tried once more without Zenoh.
"""

import base64
import contextlib
import errno
import json
import re
import socket
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from enum import Enum
from pathlib import Path
from typing import Any

import zenoh

from hyperbit.controller.host.files import read_file
from hyperbit.controller.network.endpoints import START, Endpoint, parse_endpoint, port_taken
from hyperbit.controller.network.session import TLS, reason

ATTEMPT = 3.0  # [s] for a connection, and for each answer
OWN = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM, errno.ENOSPC)
CERTIFICATES = ("listen_certificate", "connect_certificate", "root_ca_certificate")
EARLY = timedelta(days=30)  # before the end of a certificate, in which it is told
# The two times of a certificate's validity, in DER: UTCTime or GeneralizedTime.
VALIDITY = re.compile(rb"0.(?:\x17\x0d|\x18\x0f)(?:[0-9]{12,14}Z)(?:\x17\x0d|\x18\x0f)([0-9]{12,14})Z", re.DOTALL)
PEM = re.compile(r"-----BEGIN CERTIFICATE-----(.*?)-----END CERTIFICATE-----", re.DOTALL)


class Cause(Enum):
    """Why there is no session, and what to do."""

    NOBODY = START
    UNKNOWN_HOST = "check the name, or give the IP address of the computer: getent hosts NAME must print one"
    NO_ANSWER = (
        "check power, cable and firewall of that computer; if its daemon runs, read its log: journalctl -u 'hyperbit*'"
    )
    REFUSED = "give this client a certificate that the daemon accepts: deploy/certificates.sh KEYS client NAME"
    TLS = "make a new certificate as the old one was made: deploy/certificates.sh"
    OWN = "end programs that use it up, or raise its limit (ulimit -n for open files)"
    ADDRESS = "give another endpoint by --listen"


class NoSession(Exception):
    """There is no session.

    Attributes:
        cause: why.
        step: next step for the user.
    """

    def __init__(self, cause: Cause, message: str, step: str = "") -> None:
        super().__init__(message)
        self.cause, self.step = cause, step or cause.value


def open_session(config: zenoh.Config) -> zenoh.Session:
    """Opens a session.

    Raises:
        NoSession: nobody is at its endpoint, or it cannot listen there.
    """
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise diagnosis(config, error) from None


def diagnosis(config: zenoh.Config, error: zenoh.ZError) -> NoSession:
    tls = json.loads(config.get_json(TLS))
    connecting = "Unable to connect" in str(error)
    for text in endpoints(config, "connect" if connecting else "listen"):
        with contextlib.suppress(ValueError):  # a protocol that is not known here
            return missing_peer(text, tls) if connecting else unusable_address(text, error)
    return NoSession(Cause.NO_ANSWER, f"no Zenoh session: {reason(error)}")


def endpoints(config: zenoh.Config, kind: str) -> list[str]:
    """Returns the endpoints of a configuration to "connect" to, or to "listen" at; a file may have some by mode."""
    found = json.loads(config.get_json(f"{kind}/endpoints"))
    return [text for each in found.values() for text in each] if isinstance(found, dict) else found


def missing_peers(session: zenoh.Session, config: zenoh.Config) -> list[NoSession]:
    """Returns why a session has no connection to endpoints of its configuration; [] if it has all."""
    links = {parse_endpoint(link.dst)[1:] for link in session.info.links()}
    tls, found = json.loads(config.get_json(TLS)), list[NoSession]()
    for text in endpoints(config, "connect"):
        endpoint = parse_endpoint(text)
        known: set[Any] = {endpoint[1:]}
        if endpoint.address is not None:
            with contextlib.suppress(OSError):
                known |= {it[4][:2] for it in socket.getaddrinfo(*endpoint.address)}
        elif endpoint.protocol != "unixsock-stream":
            continue  # only Zenoh can try it
        if links.isdisjoint(known):
            found.append(missing_peer(text, tls))
    return found


def missing_peer(text: str, tls: Mapping[str, Any]) -> NoSession:
    """Returns why there is no session with an endpoint.

    Raises:
        ValueError: it is none that is known here.
    """
    endpoint = parse_endpoint(text)
    try:
        if endpoint.protocol == "unixsock-stream":
            with socket.socket(socket.AF_UNIX) as plain:
                plain.settimeout(ATTEMPT)
                plain.connect(endpoint.host)
        elif endpoint.address is not None:
            with socket.create_connection(endpoint.address, ATTEMPT) as plain:
                return refusing_peer(text, endpoint, tls, plain)
    except socket.gaierror as error:
        return NoSession(Cause.UNKNOWN_HOST, f"{text}: no computer is called {endpoint.host!r}: {error.strerror}")
    except (ConnectionRefusedError, FileNotFoundError):
        return NoSession(Cause.NOBODY, f"nobody listens at {text}")
    except PermissionError as error:
        return NoSession(Cause.REFUSED, f"{text}: {error.strerror}", "run the command as the daemon's user or group")
    except OSError as error:
        if error.errno in OWN:
            return NoSession(Cause.OWN, f"this computer lacks a resource for a connection: {error.strerror}")
        return NoSession(Cause.NO_ANSWER, f"no answer from {text}: {error.strerror or 'the time is over'}")
    return NoSession(Cause.NO_ANSWER, f"no answer from {text}: a program listens there, and begins no session")


def refusing_peer(text: str, endpoint: Endpoint, tls: Mapping[str, Any], plain: socket.socket) -> NoSession:
    """Returns why a program that accepts connections begins no session; speaks TLS with it by `plain`."""
    import ssl

    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    secured = endpoint.protocol == "tls"
    try:
        if secured:
            if tls.get("verify_name_on_connect") is not False:
                context.check_hostname = True
            context.verify_mode = ssl.CERT_REQUIRED
            context.load_verify_locations(tls.get("root_ca_certificate"))
            if tls.get("connect_certificate"):
                context.load_cert_chain(tls["connect_certificate"], tls.get("connect_private_key"))
        for name in ("connect_certificate", "root_ca_certificate") if secured else ():
            until = valid_until(tls.get(name))
            if until is not None and until <= datetime.now(UTC):
                return NoSession(Cause.TLS, ending({tls[name]: until})[0])
    except (OSError, TypeError, ValueError) as error:
        return NoSession(Cause.TLS, f"the certificates of the Zenoh file cannot be used: {error}")
    silent, spoken = f"no answer from {text}: a program listens there, and begins no session", False
    try:
        with context.wrap_socket(plain, server_hostname=endpoint.host) as secure:
            spoken = True
            secure.recv(1)  # a server that refuses a certificate says so after the handshake
    except ssl.SSLCertVerificationError as error:
        words = f"the certificate of {text} is not valid: {error.verify_message}"
        return NoSession(Cause.TLS, words, "renew or replace it on that computer: deploy/README.md, Certificates")
    except TimeoutError:
        if secured == spoken:
            return NoSession(Cause.NO_ANSWER, silent)
    except OSError as error:
        why = (getattr(error, "reason", "") or "").partition("ALERT_")[2].replace("_", " ").lower()
        spoken |= bool(why)
        if secured and why:
            return NoSession(Cause.REFUSED, f"{text} refuses the certificate of this client: {why}")
    if secured != spoken:
        what, right = ("does not speak TLS", "tcp") if secured else ("speaks TLS", "tls")
        step = f"write {right}/{text.partition('/')[2]}, or choose another --zenoh file"
        return NoSession(Cause.TLS, f"{text} {what}", step)
    words = f"{text} ended the connection: it is no Zenoh daemon, or has no place for another session"
    return NoSession(Cause.REFUSED, words, "read the log of the program there: journalctl -u 'hyperbit*'")


def unusable_address(text: str, error: zenoh.ZError) -> NoSession:
    """Returns why a session cannot listen at an endpoint.

    Raises:
        ValueError: it is none that is known here.
    """
    if (taken := port_taken(text)) is not None:
        return NoSession(Cause.ADDRESS, taken)
    endpoint, words = parse_endpoint(text), str(error)
    if "Name or service not known" in words or "name resolution" in words:
        return NoSession(Cause.UNKNOWN_HOST, f"{text}: no computer is called {endpoint.host!r}")
    if "assign requested address" in words:
        return NoSession(Cause.ADDRESS, f"{text}: {endpoint.host} is no address of this computer; see: ip address")
    if "Permission denied" in words:
        return NoSession(Cause.ADDRESS, f"{text}: this user may not listen there; ports below 1024 are root's")
    if "Too many open files" in words:
        return NoSession(Cause.OWN, f"this computer lacks a resource to listen at {text}: too many open files")
    return NoSession(Cause.ADDRESS, f"cannot listen at {text}: {reason(error)}")


def valid_until(file: str | None) -> datetime | None:
    try:
        pem = PEM.search(read_file(Path(file or "")).decode("ascii"))
        times = VALIDITY.search(base64.b64decode(pem[1] if pem else ""))
        text = times[1].decode() if times else ""
        return datetime.strptime(text, "%Y%m%d%H%M%S" if len(text) == 14 else "%y%m%d%H%M%S").replace(tzinfo=UTC)
    except (OSError, ValueError):
        return None


def certificates_of(config: zenoh.Config) -> dict[str, datetime]:
    """Returns the end of each certificate of a configuration, by file."""
    tls = json.loads(config.get_json(TLS))
    ends = {str(tls[name]): valid_until(tls[name]) for name in CERTIFICATES if tls.get(name)}
    return {file: until for file, until in ends.items() if until is not None}


def ending(certificates: Mapping[str, datetime], now: datetime | None = None) -> list[str]:
    """Returns a sentence for each certificate, of `certificates_of`, that has ended, or ends soon."""
    now, found = now or datetime.now(UTC), list[str]()
    for file, until in certificates.items():
        if until - now <= EARLY:
            verb, days = ("ended", "") if until <= now else ("ends", f", in {(until - now).days} days")
            renew = "renew it, see deploy/README.md, Certificates"
            found.append(f"certificate {file} {verb} on {until:%Y-%m-%d}{days}: {renew}")
    return found
