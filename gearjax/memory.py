"""Memory that this process may still use, and sizes in words."""

import math
import os
from collections.abc import Iterator
from pathlib import Path

GIB = 2.0**30


def free_memory() -> float | None:
    """Memory that this process may still use [B]; ``None`` if the system does not report it."""
    return min(_free(), default=None)


def _free() -> Iterator[float]:
    try:
        rows = dict(line.split(":", 1) for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines())
        yield 1024.0 * int(rows["MemAvailable"].split()[0])
    except (OSError, KeyError, ValueError):
        try:
            yield float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
        except (AttributeError, OSError, ValueError):
            return
    for folder, limit, used in _groups():
        try:
            allowed = int((folder / limit).read_text(encoding="ascii"))
            taken = int((folder / used).read_text(encoding="ascii"))
            rows = dict(line.split() for line in (folder / "memory.stat").read_text(encoding="ascii").splitlines())
        except (OSError, ValueError):  # no such group, or "max"
            continue
        # memory of the file cache counts as used, but the system releases it when a process needs it
        yield float(allowed - taken + int(rows.get("file", rows.get("total_cache", 0))))


def _groups() -> Iterator[tuple[Path, str, str]]:
    """Control groups (cgroups, versions 1 and 2) of this process, with the file names of their limits and usage."""
    try:
        own = Path("/proc/self/cgroup").read_text(encoding="utf-8").splitlines()
    except OSError:
        return
    for line in own:
        _, controllers, path = line.split(":", 2)
        if controllers and "memory" not in controllers.split(","):
            continue
        root = Path("/sys/fs/cgroup") / ("memory" if controllers else "")
        limit, used = ("limit_in_bytes", "usage_in_bytes") if controllers else ("max", "current")
        inner = root / path.strip("/")
        for folder in (inner, *(level for level in inner.parents if level.is_relative_to(root))):
            yield folder, f"memory.{limit}", f"memory.{used}"


def size_words(number: float) -> str:
    """A number of bytes in words, such as ``1.5 GiB``."""
    return f"{number / GIB:.2g} GiB" if 0.1 * GIB <= number < 100 * GIB else _small_or_large(number)


def _small_or_large(number: float) -> str:
    return f"{number / GIB:,.0f} GiB" if number >= GIB else f"{max(1.0, math.ceil(number / 2**20)):.0f} MiB"


def fitting(most: float) -> str:
    """Words that say how many of something fit into the memory, rounded down to two digits."""
    if most < 2:
        return "not even one fits: use a machine with more memory"
    step = 10.0 ** max(0, math.floor(math.log10(most)) - 1)
    return f"at most {math.floor(most / step) * step:.0f} fit"
