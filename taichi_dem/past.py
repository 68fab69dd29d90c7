"""Values of the last steps, latest first: kept, and extrapolated to the next step."""

from taichi_dem.types import ti

FORGET = 0.1  # of what is known of the misses, at every step


@ti.func
def shifted(past: ti.template(), latest):
    """The values that are kept when there is a ``latest`` one."""
    kept = past
    for step in ti.static(range(past.n - 1, 0, -1)):
        kept[step] = kept[step - 1]
    kept[0] = latest
    return kept


@ti.func
def extrapolated(past: ti.template(), number):
    """The next value, by the polynomial through the latest ``number``, or as many as are kept."""
    next_one = 0.0
    if number == 1:
        next_one = past[0]
    elif number >= 2:
        next_one = 2.0 * past[0] - past[1]
    if ti.static(past.n >= 3):
        if number >= 3:
            next_one = 3.0 * (past[0] - past[1]) + past[2]
    if ti.static(past.n >= 4):
        if number >= 4:
            next_one = 4.0 * (past[0] + past[2]) - 6.0 * past[1] - past[3]
    return next_one


@ti.func
def judged(missed: ti.template(), past: ti.template(), age, latest):
    """By how much polynomials through two values, three and so on miss the next one, where
    ``missed`` is what they did before; ``past`` holds ``age`` values and not yet the ``latest``."""
    now = missed
    for number in ti.static(range(2, past.n + 1)):
        if age >= number:
            miss = ti.abs(latest - extrapolated(past, number))
            now[number - 2] += FORGET * (miss - missed[number - 2])
    return now


@ti.func
def best(missed: ti.template(), age):
    """Through how many of ``age`` values the polynomial goes that has missed least: more follow
    a motion, fewer multiply less what the values are wrong by."""
    number = age
    if age >= missed.n + 1:
        least = missed[missed.n - 1]
        for fewer in ti.static(range(missed.n, 1, -1)):
            if missed[fewer - 2] < least:
                number, least = fewer, missed[fewer - 2]
    return number
