"""The colours of every picture: those of Okabe and Ito, which people who see colours differently tell apart too.

M. Okabe and K. Ito, "Color Universal Design", 2008. What two colours tell apart, a line style, a marker or a word tells
apart as well: pictures are printed in grey.
"""

from __future__ import annotations

from typing import Final

BLUE: Final = "#0072B2"
VERMILLION: Final = "#D55E00"
GREEN: Final = "#009E73"
ORANGE: Final = "#E69F00"
SKY: Final = "#56B4E9"
PURPLE: Final = "#CC79A7"

SAFE: Final = BLUE
"""φ."""
KAMIKAZE: Final = VERMILLION
"""ψ."""
MARGIN: Final = GREEN
"""Trajectories of the margin: the least deviation that would have been enough. Drawn dashed beside ψ."""
ALERT: Final = "#A33B00"
"""Of words that must not be missed: a darker vermillion, which can be read on white."""
BELIEF: Final = PURPLE
"""Where a kamikaze believes the car to be."""
CAR: Final = "#5B6770"
OBSTACLE: Final = "#B8BDC2"
"""What is parked."""
BEHIND: Final = "#888888"
"""What other figures are seen against."""
ROAD: Final = "#E8E8E8"
ROAD_EDGE: Final = "#999999"

SERIES: Final = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY)
"""Of several cars or kinds of φ in one picture, in this order."""
DASHES: Final = ((), (6, 2), (2, 2), (8, 2, 2, 2), (4, 1, 1, 1), (1, 2))
"""Their line styles, as lengths of strokes and gaps."""
SHAPES: Final = ("circle", "square", "triangle-up", "diamond", "triangle-down", "cross")
"""Their markers, as Vega calls them."""

_ORDER: Final = ((213, 94, 0), (230, 159, 0), (86, 180, 233), (0, 114, 178))


def ordered(count: int) -> list[str]:
    """Return colours for things in an order, as cars by their C: vermillion to blue.

    Red-green blindness does not touch the axis from orange to blue, so that the order is seen by everybody.
    """
    if count == 1:
        return [BLUE]
    found = []
    for index in range(count):
        place = index * (len(_ORDER) - 1) / (count - 1)
        low = min(int(place), len(_ORDER) - 2)
        share = place - low
        mixed = (round(a + share * (b - a)) for a, b in zip(_ORDER[low], _ORDER[low + 1], strict=True))
        found.append("#" + "".join(f"{channel:02X}" for channel in mixed))
    return found


def of_cars(count: int) -> list[str]:
    """Return the colour of each of several cars, in the order in which they were given: the same in every picture."""
    return list(SERIES[:count]) if count <= len(SERIES) else ordered(count)
