import re

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.output import svg_plots as svg

pytestmark = pytest.mark.once  # about texts, the same on every Blender


def test_a_long_legend_stays_under_its_plot():
    long = (
        "exact walk, frame by frame, mean (does not converge: 0.1% of agents end over a cell away)"
    )
    rows = [svg.Series(name, np.zeros((1, 2)), "#000") for name in (long, "short")]
    sheet = svg.sheet("Title", "caption", [svg.Panel("", 100.0, rows)] * 2)
    texts = re.findall(r'<text x="42" y="\d+" dy=".33em">([^<]*)', sheet)
    assert " ".join(texts[:2]) == long and texts[2] == "short" and len(texts) == 6
    assert max(map(len, texts)) <= svg.LEGEND_LETTERS
    rows_at = [float(y) for y in re.findall(r'<g transform="translate\(58,([\d.]+)\)', sheet)]
    assert rows_at[1] - rows_at[0] == 2 * svg.LEGEND_ROW


def test_numbers_are_short():
    values = 12_000, 1.5e6, 0.25, 0.001, 0.0001, 2.5e-6, 0.0
    assert list(map(svg.short, values)) == ["12k", "1.5M", "0.25", "0.001", "1e-4", "2.5e-6", "0"]
