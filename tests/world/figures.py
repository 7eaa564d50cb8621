"""Figures as objects, to be inspected by tests."""

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def saved(draw) -> Figure:
    """Call ``draw`` and return the one Figure that it renders."""
    pages, save = [], FigureCanvasAgg.draw

    def keep(canvas, *arguments, **named):
        pages.append(canvas.figure)
        save(canvas, *arguments, **named)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FigureCanvasAgg, "draw", keep)
        draw()
    (page,) = pages
    return page
