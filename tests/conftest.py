"""What all tests share: the same examples of Hypothesis every time, no network, and an option for golden hashes."""

import errno
import ipaddress
import socket
import sys

from hypothesis import HealthCheck, settings

settings.register_profile("push", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("nightly", deadline=None, max_examples=2000, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("push")


def pytest_addoption(parser):
    parser.addoption(
        "--golden-update", action="store_true", help="rewrite tests/physics/golden.json with what is computed now"
    )


LOOKUPS = ("socket.getaddrinfo", "socket.gethostbyname", "socket.gethostbyaddr")
HERE = (None, "", "localhost", socket.gethostname())


def ip(host):
    """An address written as a number; None for a name, which would have to be looked up."""
    try:
        return ipaddress.ip_address(host.decode() if isinstance(host, bytes) else host)
    except ValueError:
        return None


def stay_here(event, arguments):
    """Have the tests run as on a machine without a network (SE-9)."""
    if event in ("socket.connect", "socket.sendto", "socket.sendmsg"):
        tried, address = arguments[:2]
        host = address[0] if isinstance(address, tuple) else None
        # Connecting a datagram socket sends nothing: dask finds out its own address so.
        sends = event != "socket.connect" or tried.type != socket.SOCK_DGRAM
        if sends and host not in HERE and not ((found := ip(host)) and found.is_loopback):
            raise OSError(errno.ENETUNREACH, f"{host} is not on loopback")
    elif event in LOOKUPS and arguments[0] not in HERE and ip(arguments[0]) is None:
        raise socket.gaierror(socket.EAI_NONAME, f"{arguments[0]} is not on loopback")


sys.addaudithook(stay_here)
