"""Powers that the compiler can turn into SIMD code: no library calls, no branches, no division."""

from taichi_dem.types import PRECISION, real, ti

# Halving and thirding an exponent is integer arithmetic on the bits of a float.  The constant is
# 4/3 of the exponent's bias, less what makes the worst error of the first guess least (3.4 %).
_DOUBLE = PRECISION == "double"
_GUESS = 1430188164 if _DOUBLE else 1419837420


@ti.func
def inverse_cube_root(x: real) -> real:
    """x^(-1/3) for x > 0, to rounding; finite at zero, so that x times its square is 0 there.

    From a guess r with x r^3 = 1 - h, a step multiplies r by the first terms of (1 - h)^(-1/3):
    the error goes from 3e-2 to 2e-5, then to 3e-16.
    """
    root = 0.0
    if ti.static(_DOUBLE):
        high = ti.cast(ti.bit_cast(x, ti.i64) >> 32, ti.i32)
        root = ti.bit_cast(ti.cast(_GUESS - ti.raw_div(high, 3), ti.i64) << 32, real)
    else:
        root = ti.bit_cast(_GUESS - ti.raw_div(ti.bit_cast(x, ti.i32), 3), real)
    for _ in ti.static(range(2)):
        h = 1.0 - x * root * root * root
        root *= 1.0 + h * (1.0 / 3.0 + h * (2.0 / 9.0 + h * (14.0 / 81.0)))
    return root


@ti.func
def cube_root(x: real) -> real:
    """x^(1/3) for x >= 0, to rounding."""
    root = inverse_cube_root(x)
    return x * root * root


@ti.func
def polynomial(x: real, coefficients: ti.template()) -> real:
    """The sum of ``coefficients`` times x^0, x^1, ...; they are known when compiling."""
    result = 0.0
    for c in ti.static(coefficients[::-1]):
        result = result * x + c
    return result


def _parts(exponent: float, part: int, most: int) -> bool:
    """Whether ``exponent`` is a whole number of 1/``part``, and at most ``most``."""
    return exponent <= most and abs(part * exponent - round(part * exponent)) < 1e-12


@ti.func
def power(x: real, exponent: ti.template()) -> real:
    """x^exponent for x >= 0 and an ``exponent`` >= 0 known when compiling: by roots where it is a
    small multiple of 1/2 or 1/3, else by the library's (slower) power."""
    result = 1.0
    if ti.static(_parts(exponent, 2, 4)):
        for _ in ti.static(range(int(exponent))):
            result *= x
        if ti.static(round(2 * exponent) % 2 == 1):
            result *= ti.sqrt(x)
    elif ti.static(_parts(exponent, 3, 2)):
        root = cube_root(x)
        for _ in ti.static(range(round(3 * exponent))):
            result *= root
    else:
        result = x**exponent
    return result
