"""The gallery's grid: a card for each demo, with its picture and its title."""

from __future__ import annotations

import re

from gallery import DEMOS, page

_CARD = """\
:::{{grid-item-card}}
:img-top: {picture}
:img-alt: {alt}
:link: {name}
:link-type: doc

{title}
:::
"""


def markdown(names: str) -> str:
    """Return a grid of the demos with these names, separated by commas, in this order."""
    cards = []
    for name in names.split(","):
        text = page(DEMOS / f"{name}.py")
        title = re.search(r"^# (.*)$", text, re.M)
        picture = re.search(r"^!\[(.*)\]\((.*)\)$", text, re.M)
        assert title and picture, f"demos/{name}.py: expected a title and a picture"
        cards.append(_CARD.format(title=title[1], alt=picture[1], picture=picture[2], name=name))
    return "\n".join(["::::{grid} 1 2 3 3", ":gutter: 3", "", *cards, "::::"])
