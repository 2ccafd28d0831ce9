"""Numbers are rounded alike on all x86-64 processors with AVX2.

The order of sums and the approximations of functions in OpenBLAS and NumPy depend on the processor.
Their last bits differ, and after some seconds of music so do the notes that are played. Both
libraries read their choice from the environment, once, when they are imported.
"""

import os
import warnings
from functools import cache

from cadenza.errors import CadenzaWarning

_KERNEL = "Haswell"  # the first processors with AVX2
_SAME = {_KERNEL, "Zen"}
_NEWER = {"X86_V4", "AVX512F", "AVX512_SKX"}
"""NumPy's names of AVX-512, which is disabled; since 2.4 it is the first one."""


def round_as_haswell() -> None:
    """Have OpenBLAS and NumPy, if imported later, round as on Haswell, the first with AVX2.

    This also holds for processes that are started by this one. Without AVX2, nothing is changed.
    """
    if not _has_avx2():
        return
    os.environ["OPENBLAS_CORETYPE"] = _KERNEL
    if not os.environ.get("NPY_ENABLE_CPU_FEATURES"):  # NumPy fails if given both
        given = os.environ.get("NPY_DISABLE_CPU_FEATURES", "").replace(",", " ").split()
        os.environ["NPY_DISABLE_CPU_FEATURES"] = " ".join(sorted(_NEWER.union(given)))
        warnings.filterwarnings("ignore", "During parsing.*NPY_DISABLE", ImportWarning)


@cache
def check_rounding() -> None:
    """Warn once if NumPy was imported too early to round as on Haswell, and does not."""
    import numpy as np
    from threadpoolctl import threadpool_info

    pools = threadpool_info()
    kernels = {p["architecture"] for p in pools if p["internal_api"] == "openblas"}
    extensions = np.show_config("dicts")["SIMD Extensions"].get("found", ())
    if _has_avx2() and (kernels - _SAME or _NEWER.intersection(extensions)):
        warnings.warn(
            "NumPy was imported before cadenza, and rounds as only processors like this one do: "
            "elsewhere, other notes are missed; import cadenza first",
            CadenzaWarning,
            stacklevel=2,
        )


def _has_avx2() -> bool:
    """Whether the processor has AVX2, according to Linux."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as about:
            return any("avx2" in line for line in about)
    except OSError:
        return False
