"""Memory checkers: the compiled tick and Box2D are clean under them, and they find a write beyond the end of a block.

How other tests run under a checker, and under Valgrind, is in docs/reliability.md.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PLAY = """
import numpy as np
import outlast
from tests.conftest import digest, draw_actions
rng, crowd = np.random.default_rng(0), {"agents_count": 12, "room_size": 10.0, "safe_zone_radii": (5.0, 3.0)}
for numbers in ({}, crowd):
    game = outlast.variant("teams_4").replace(**numbers, physics_backend="native")
    env = outlast.make_vec(game, 8, seed=3, threads=2)
    env.reset()
    for _ in range(20):
        env.step(draw_actions(env, rng))
    print(digest(env.worlds), flush=True)
    env.close()
"""
BEYOND = """
import ctypes
from outlast.systems.box2d import layout
system = ctypes.CDLL(None)
system.malloc.restype = ctypes.c_void_p
system.free.argtypes = [ctypes.c_void_p]
zeros, blocks = ctypes.c_int64(), [system.malloc(layout.BODY_SIZE) for _ in range(8)]
ctypes.memset(blocks[3], 1, layout.BODY_SIZE + 24)
for block in blocks: system.free(block)
print("survived")
"""


def library(name: str) -> str:
    """The path of a shared library that the C compiler finds; its name if it does not."""
    command = (shutil.which("gcc") or "echo", f"-print-file-name={name}")
    return os.path.realpath(subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip())


def checker(name: str) -> dict[str, str]:
    """Variables of processes under a checker.

    perturbed: glibc fills fresh memory with 0x5A and freed memory with 0xA5, and checks its heap at each call. asan:
    AddressSanitizer puts red zones around blocks and keeps freed ones.
    """
    if name == "perturbed":
        check = {"MALLOC_PERTURB_": "165", "MALLOC_CHECK_": "3", "GLIBC_TUNABLES": "glibc.malloc.check=3"}
        return {"LD_PRELOAD": "libc_malloc_debug.so.0", **check}
    preload = f"{library('libasan.so')}:{library('libstdc++.so')}"
    options = "detect_leaks=0:check_initialization_order=0"
    return {"LD_PRELOAD": preload, "ASAN_OPTIONS": options, "PYTHONMALLOC": "malloc"}


def run(code: str, variables: dict[str, str]) -> tuple[int, list[str], list[str]]:
    """Run Python with variables: its status, the lines of its output, and those in which a checker reports an error."""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=ROOT, env=os.environ | variables, capture_output=True, text=True)
    if "cannot be preloaded" in done.stderr:
        pytest.skip(f"needs {variables['LD_PRELOAD']}")
    faulty = re.compile(r"ERROR: AddressSanitizer|free\(\): invalid|corrupted|malloc\(\): |double free")
    return done.returncode, done.stdout.split(), [line for line in done.stderr.splitlines() if faulty.search(line)]


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["perturbed", "asan"])
def test_the_backend_is_clean_under(name: str) -> None:
    plain, checked = run(PLAY, {}), run(PLAY, checker(name))
    assert checked == plain == (0, plain[1], [])
    assert len(plain[1]) == 2


def test_what_is_written_beyond_a_block_is_found() -> None:
    status, output, errors = run(BEYOND, checker("perturbed"))
    assert status or errors, output
