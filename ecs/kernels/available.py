"""The cores and the memory that this process may use: affinity and control groups limit its share of a machine."""

import math
import os
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

PROC = Path("/proc")


def available_cores() -> int:
    """Return the number of cores that this process may use, at least 1.

    Its affinity and the quotas of its control groups (containers, jobs of a cluster) count, rounded up to whole cores.
    """
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min([allowed, *map(math.ceil, _quotas())]))


def available_memory() -> float:
    """Return the number of bytes that this process can take from what is free; infinity where that is unknown."""
    words = _text(PROC / "meminfo").split()
    free = [int(words[words.index("MemAvailable:") + 1]) * 1024] if "MemAvailable:" in words else []
    return max(0, min([math.inf, *free, *_rests_of_limits()]))


def _quotas() -> Iterator[float]:
    """Yield the quotas of this process's control groups in cores."""
    for group in _control_groups("cpu"):
        found = _numbers(group / "cpu.max") or _numbers(group / "cpu.cfs_quota_us", group / "cpu.cfs_period_us")
        if len(found) == 2 and min(found) > 0:
            yield found[0] / found[1]


def _rests_of_limits() -> Iterator[int]:
    """Yield the bytes that the memory limits of this process's control groups leave; cached files can be dropped."""
    for group in _control_groups("memory"):
        found = _numbers(group / "memory.max", group / "memory.current")
        found = found or _numbers(group / "memory.limit_in_bytes", group / "memory.usage_in_bytes")
        if len(found) == 2:
            words = _text(group / "memory.stat").split()
            parts = dict(zip(words[::2], words[1::2], strict=False))
            files = [parts.get(f"total_{name}", parts.get(name, 0)) for name in ("active_file", "inactive_file")]
            yield found[0] - found[1] + sum(map(int, files))


def _control_groups(controller: str) -> Iterator[Path]:
    """Yield the folders of this process's control groups of versions 1 and 2, and of those around them."""
    paths: dict[str, str] = {}  # by the names of version 1's controllers; version 2's has the name ""
    for line in _text(PROC / "self" / "cgroup").splitlines():
        _, names, path = line.split(":", 2)
        paths |= dict.fromkeys(names.split(","), path)
    for line in _text(PROC / "self" / "mountinfo").splitlines():
        before, _, after = line.partition(" - ")
        root, mount = before.split()[3:5]
        kind, options = after.split()[0], after.split()[-1].split(",")
        if kind == "cgroup2" or (kind == "cgroup" and controller in options):
            own = PurePosixPath(paths.get("" if kind == "cgroup2" else controller, root))
            group = Path(mount, own.relative_to(root) if own.is_relative_to(root) else "")
            yield from (each for each in (group, *group.parents) if each.is_relative_to(mount))


def _text(path: Path) -> str:
    try:
        return path.read_text()
    except OSError:
        return ""


def _numbers(*paths: Path) -> list[int]:
    """Return the integers in these files; none if there are others than integers, such as "max"."""
    words = [word for path in paths for word in _text(path).split()]
    return [int(word) for word in words] if all(word.removeprefix("-").isdecimal() for word in words) else []
