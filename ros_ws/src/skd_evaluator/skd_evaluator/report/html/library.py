"""The charts' library, as vl-convert carries it: Vega, Vega-Lite and what embeds them, in one piece of JavaScript."""

from __future__ import annotations

import functools

VEGA_LITE = "6.4"


@functools.cache
def chart_library() -> str:
    """Return the script that defines `vegaEmbed`; it needs no network, neither to be made nor to run."""
    import vl_convert

    # In a block of its own: its names must not meet those of the page.
    return "{" + str(vl_convert.javascript_bundle("window.vegaEmbed = vegaEmbed;", VEGA_LITE)) + "}"
