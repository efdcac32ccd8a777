"""PyTorch's settings that a caller may have changed; none of them changes the results here.

The default dtype and device have no effect, since every new tensor names both (a test checks that). The rest is
restored before a caller's code continues.
"""

import contextlib
import threading
from collections.abc import Iterator
from typing import Any

import torch

FLOAT: dict[str, Any] = {"dtype": torch.float32, "device": "cpu"}
INDEX: dict[str, Any] = {"dtype": torch.int64, "device": "cpu"}
EXACT = ("none", "ieee", "highest")  # precisions of float32 products that do not round factors
PRODUCTS: Any = getattr(torch.backends.mkldnn, "matmul", None)  # None before PyTorch 2.9
LOCK = threading.RLock()  # held while a policy plays with settings that differ from the caller's


@contextlib.contextmanager
def playing() -> Iterator[None]:
    """Run PyTorch on one thread, in float32 and without gradients, and then restore the caller's settings.

    The number of threads is also that of the caller's own networks. Networks this small are slower on several threads,
    much slower on busy cores, since threads wait for each other. On one thread, sums are also the same everywhere. The
    changes take a few microseconds.
    """
    with LOCK, torch.inference_mode():
        threads, precision, cast = torch.get_num_threads(), _precision(), torch.is_autocast_enabled("cpu")
        torch.set_num_threads(1)
        if cast or precision:  # seldom, and slower
            torch.set_autocast_enabled("cpu", False)
            _set_precision("")
        try:
            yield
        finally:
            torch.set_num_threads(threads)
            if cast or precision:
                torch.set_autocast_enabled("cpu", cast)
                _set_precision(precision)


@contextlib.contextmanager
def learning() -> Iterator[None]:
    """Make tensors that have gradients, in any mode of the caller, and compute with them in float32 on the CPU.

    On a GPU, products round as the caller has set.
    """
    precision = _precision()
    _set_precision("")
    try:
        with (
            torch.autocast("cpu", enabled=False),
            torch.autocast("cuda", enabled=False),
            torch.inference_mode(False),
            torch.enable_grad(),
        ):
            yield
    finally:
        _set_precision(precision)


def _precision() -> str:
    """Return the precision to which products on the CPU round factors; "" if they do not."""
    found: str = PRODUCTS.fp32_precision if PRODUCTS else torch.get_float32_matmul_precision()
    return "" if found in EXACT else found


def _set_precision(precision: str) -> None:
    """Restore what `_precision` returned. Unchanged settings are not set, since they may be inherited."""
    if precision == _precision():
        return
    if PRODUCTS:
        PRODUCTS.fp32_precision = precision or "ieee"
    else:
        torch.set_float32_matmul_precision(precision or "highest")
