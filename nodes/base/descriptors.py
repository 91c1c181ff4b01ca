"""File descriptors: a node ends in order before it runs out of them.

ZeroMQ aborts a process without a free descriptor when a peer connects over ipc.
"""

import os
import resource

# descriptors that must remain free, and the least part of all: connections come faster than checks
SPARE, PART = 32, 4


def take() -> None:
    """Raise this process's limit of open files to the maximum."""
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def _are_short() -> bool:
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    try:
        used = len(os.listdir("/proc/self/fd"))
    except OSError:
        # none left for this very check
        return True
    return limit != resource.RLIM_INFINITY and used > limit - max(SPARE, limit // PART)


def shortage() -> str:
    """Return why this process must end while it can, or ""."""
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
