"""Numba's own features in a user's kernels, and a user's own numba functions beside the engine's machine code.

Each is tried in a process that compiles and in one that loads: what machine code needs of a process must be there in
both. A mistake here is a crash, so all of it runs in processes of its own.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from outlast.ecs.kernels.cache_files import SUFFIX
from tests.engine.test_compile import ROOT, compiled_only

pytestmark = compiled_only

GAME = """
import sys
sys.path[:0] = [{folder!r}, {root!r}]
import numba
import numpy as np
from outlast.ecs import Rows, Write, kernel
from tests.helpers.toy_game import STEP, Energy, Walkers, make, run, system_of

{helper}

def act(energy: Write[Energy], rows: Rows[Energy]) -> None:
    for e in rows:
        energy.left[e] = {expression}

worlds = run(make(Walkers(), system_of(act)), STEP)
print(worlds[Energy].left[0, 2], worlds.units.compiled, {python}, sep="|")
"""

BEFORE = """
def theirs():
    @numba.njit
    def f(x):
        values = [x, 1.0]
        values.append(np.sort(np.array([3.0, x]))[0])
        return np.zeros(2).sum() + sum(values) + len(str(int(x)))
    @numba.njit(parallel=True)
    def g(x):
        total = 0.0
        for i in numba.prange(x.size):
            total += x[i]
        return total
    h = numba.vectorize(["float64(float64)"])(lambda x: 2 * x)
    c = numba.cfunc("float64(float64)")(lambda x: x / 2)
    return f(2.0), g(np.ones(9)), float(h(np.ones(1))[0]), c.ctypes(3.0)
first = [*theirs()]
"""
KERNELS = {  # definitions, what the system computes for row 2, its value, and what Python computes afterwards
    "an array": ("", "np.zeros(3, np.int32)[e] + np.arange(5).sum()", 10, "0"),
    "a list that is sorted": ("", "sorted([7, e, 5])[0]", 2, "0"),
    "text": ("", "len(str(e) + 'abc')", 4, "0"),
    "an array in a helper of a helper": (
        "@kernel\ndef inner(n):\n    a = np.zeros(4)\n    return a.sum() + n\n"
        "@kernel\ndef outer(n):\n    return inner(n) + 1 if n > 0 else 0.0\n", "int(outer(e)) + int(inner(e))", 5, "0",
    ),
    "a function that Python calls, too": (
        "@numba.njit\ndef inner(n):\n    return np.ones(3).sum() + n\n"
        "@numba.njit\ndef half(n):\n    return np.sqrt(inner(n)) / 2\n",
        "int(4 * half(np.int64(6)))", 6, "[half(6), numba.njit(lambda n: half(n) + 1)(6)]",
    ),
    "a function with numba's cache": (
        "from theirs import middle", "middle(e)", 3, "[middle(2), numba.njit(lambda n: middle(n) + 1)(2)]",
    ),
    "functions that the user compiles before and after": (
        BEFORE, "np.int32(np.sort(np.array([5.0, e]))[0])", 2, "[*theirs()] == first == [6, 9, 2, 1.5]",
    ),
    "a large array": ("TABLE = np.arange(300_000)", "TABLE[-1 - e]", 299_997, "0"),
}  # fmt: skip
PYTHON = {  # else 0
    "a function that Python calls, too": "[1.5, 2.5]", "a function with numba's cache": "[3, 4]",
    "functions that the user compiles before and after": "True",
}  # fmt: skip
THEIRS = """
import numba
import numpy as np

@numba.njit(cache=True)
def middle(n):
    return np.sort(np.array([n + 1, 9, 1]))[1]
"""


def in_process(script: str, folder: Path) -> list[str]:
    environment = os.environ | {"OUTLAST_CACHE_DIR": str(folder / "cache")}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, timeout=250)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip().split("|")


@pytest.mark.nightly
@pytest.mark.parametrize("kind", KERNELS)
def test_kernels_use_numba(tmp_path: Path, kind: str) -> None:
    helper, expression, value, python = KERNELS[kind]
    (tmp_path / "theirs.py").write_text(THEIRS)
    script = GAME.format(folder=str(tmp_path), root=str(ROOT), helper=helper, expression=expression, python=python)
    first, second = in_process(script, tmp_path), in_process(script, tmp_path)
    assert first[0] == second[0] == str(value)
    assert first[2] == second[2] == PYTHON.get(kind, "0")
    assert "local.act" in first[1]
    kept = len([*(tmp_path / "cache").glob(f"local.act-*{SUFFIX}")])
    assert kept == (kind != "a large array")  # whose address is that of this process
    assert ("local.act" in second[1]) == (not kept)
