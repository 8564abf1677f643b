"""What this machine's arithmetic gives, to the last bit: if two machines differ, so may their simulations."""

from __future__ import annotations

import hashlib
import math

import numba
import numpy as np

_POINTS = np.linspace(-9.7, 9.3, 1021)


def arithmetic_digest() -> str:
    """Return a digest of functions whose last bit hangs on the processor and on libraries that pick code for it.

    numpy, BLAS and libm have several versions of each, by the processor's instructions. What numba compiles keeps to
    the order of operations, unless it has Intel's vector functions.
    """
    x, positive = _POINTS, np.abs(_POINTS) + 1e-3
    square = np.sin(np.arange(4096.0)).reshape(64, 64)
    with np.errstate(all="ignore"):
        vectors = [
            *(function(x) for function in (np.sin, np.cos, np.tan, np.exp, np.arctan, np.tanh, np.expm1)),
            *(function(positive) for function in (np.log, np.log1p, np.sqrt, np.cbrt)),
            *(function(x, x[::-1]) for function in (np.hypot, np.arctan2)),
            np.power(positive, x),
            square @ square.T,
            np.array([x.sum(), x.dot(x), x.std(), np.linalg.norm(x)]),
        ]
    scalars = [
        *(function(one) for function in (math.sin, math.cos, math.tan, math.exp, math.erf) for one in x),
        *(function(one) for function in (math.log, math.lgamma, math.gamma) for one in positive),
        *(function(one, 0.7) for function in (math.hypot, math.atan2, math.fmod) for one in x),
        *(math.pow(one, 1.3) for one in positive),
    ]
    digest = hashlib.sha256(f"vector functions {vars(numba.config)['USING_SVML']}".encode())
    for array in (*vectors, np.array(scalars)):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
