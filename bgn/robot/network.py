"""Where a robot is spoken to, and the rule that nothing but a loopback address is without saying so twice."""

from __future__ import annotations

import ipaddress
import sys
from typing import Final

from bgn.robot.errors import UsageError

RTDE_PORT: Final = 30004
SCRIPT_PORT: Final = 30003
DASHBOARD_PORT: Final = 29999
CONTROL_PORT: Final = 30099  # the twin's own
#: Where a twin is by default. The client library skips its own remote-control check at 127.0.0.1, which is the only
#: loopback address of a Mac.
TWIN_HOST: Final = "127.0.0.2" if sys.platform == "linux" else "127.0.0.1"


def is_loopback(host: str) -> bool:
    """Whether a numeric address is a loopback one; names are not looked up."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def check_host(host: str | None, *, real: bool) -> str:
    """Return the host if it may be spoken to.

    Raises
    ------
    UsageError
        No host was given, it is not a numeric address, or it is not a loopback one and ``real`` was not said.
    """
    if host is None:
        raise UsageError(
            "no robot: give its address with --host, and --real if it is not a twin on this machine"
        )
    try:
        ipaddress.ip_address(host)
    except ValueError as error:
        raise UsageError(f"--host {host}: a numeric address is needed, such as 192.168.1.10") from error
    if not is_loopback(host) and not real:
        raise UsageError(f"--host {host} is not on this machine: add --real to move a real robot there")
    return host


def check_twin_host(host: str) -> str:
    """Return the address if a twin may listen there.

    Raises
    ------
    UsageError
        It is not a loopback one.
    """
    if not is_loopback(host):
        raise UsageError(f"--host {host}: a twin listens on loopback addresses only, such as {TWIN_HOST}")
    return host
