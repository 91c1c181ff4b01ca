"""Descriptors: ZeroMQ aborts a process that has none left when somebody connects over ipc; so a node ends in order before."""

import os
import resource

# so many must be left, and at least this part of all: connections come faster than anybody looks
SPARE, PART = 32, 4


def take() -> None:
    """Let the process open as many files and connections as it may."""
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def _are_short() -> bool:
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    try:
        used = len(os.listdir("/proc/self/fd"))
    except OSError:
        # Not even one to look with.
        return True
    return limit != resource.RLIM_INFINITY and used > limit - max(SPARE, limit // PART)


def shortage() -> str:
    """Why this process must end while it can; empty when enough are left, or could be had."""
    if not _are_short():
        return ""
    take()
    if not _are_short():
        return ""
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    return (
        f"of {most} descriptors, the limit (ulimit -n), too few are left; without one the next"
        " connection would abort it"
    )
