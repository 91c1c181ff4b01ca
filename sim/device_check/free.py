"""Free a device: name the process that uses it, or switch its forces off and release it."""

from pathlib import Path
from typing import Any

from messages.errors import RefusedError
from nodes.driver.hardware.mailbox import MailboxDevice


def holders(library: str | None) -> list[tuple[int, str]]:
    """Return number and command of the processes that have a library loaded."""
    if not library:
        return []
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdecimal():
            try:
                maps = (folder / "maps").read_text(encoding="utf-8", errors="replace")
                command = (
                    (folder / "cmdline")
                    .read_bytes()
                    .replace(b"\0", b" ")
                    .decode(errors="replace")
                    .strip()
                )
            except OSError:
                # It has ended, or belongs to another user.
                continue
            if f"{library}\n" in maps or f"/{Path(library).name}\n" in maps:
                found.append((int(folder.name), command))
    return sorted(found)


def free(device: MailboxDevice) -> dict[str, Any]:
    """Release a device; refuse if another process uses it, or if it cannot be reached."""
    others = holders(type(device).find(device.parameters).library)
    if others:
        named = "; ".join(
            f"process {number}: {command[:120]}" for number, command in others
        )
        raise RefusedError(
            f"{device.TITLE}: held by {named}. End that first: haptic stop, or kill the process"
        )
    try:
        device.connect()
        device.identify()
    except OSError as error:
        raise RefusedError(str(error)) from error
    finally:
        device.close()
    return {"freed": True, "facts": device.facts}
