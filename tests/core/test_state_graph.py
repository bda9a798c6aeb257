"""The picture of a state machine, against what its JSON says."""

import json
import re
from xml.etree import ElementTree

import pytest
from crowd_lod_extension.crowd_lod.crowd.state_machine import (
    load_preset,
    parse,
    preset_names,
    preset_text,
)
from crowd_lod_extension.crowd_lod.reporting.state_graph import svg

SVG = "{http://www.w3.org/2000/svg}"


def followers(root):
    """{(state, state): labels} by the JSON itself."""
    found = {}
    for state, entry in root["states"].items():
        rules = {
            label: entry["on"].get(label, entry["on"].get("*")).get("next", state)
            for label in root["labels"]
        }
        for label, following in [*rules.items(), ("after its time", entry.get("then", state))]:
            weights = following if isinstance(following, dict) else {following: 1}
            for other in (other for other, weight in weights.items() if weight and other != state):
                found.setdefault((state, other), set()).add(label)
    return found


@pytest.mark.parametrize("name", preset_names())
def test_an_arrow_for_each_state_that_follows_names_its_labels(name):
    tree = ElementTree.fromstring(svg(load_preset(name)))
    titles = [group.find(f"{SVG}title").text for group in tree.iter(f"{SVG}g")]
    found = {}
    for title in titles:
        pair, labels = title.split(": ")
        found[tuple(pair.split(" to "))] = set(labels.split(", "))
    assert found == followers(json.loads(preset_text(name)))


@pytest.mark.parametrize("name", preset_names())
def test_all_of_it_lies_in_the_picture(name):
    tree = ElementTree.fromstring(svg(load_preset(name)))
    _, _, width, height = map(float, tree.get("viewBox").split())
    for text in tree.iter(f"{SVG}text"):
        size = float(re.search(r"font:(\d+)px", text.get("style"))[1])
        half = {"start": (0, 1), "middle": (0.5, 0.5), "end": (1, 0)}[text.get("text-anchor")]
        wide = 0.57 * size * len(text.text)
        x = float(text.get("x"))
        y = float(text.get("y"))
        assert x - half[0] * wide > 0 and x + half[1] * wide < width and size < y < height, (
            text.text
        )
    for circle in tree.iter(f"{SVG}circle"):
        assert (
            20 < float(circle.get("cx")) < width - 20 and 20 < float(circle.get("cy")) < height - 20
        )


def test_names_of_any_kind_are_text():
    wild = preset_text("chapter").replace("walk left", 'a<b>&\\"c')
    tree = ElementTree.fromstring(svg(parse(wild, "t")))
    assert 'a<b>&"c' in [text.text for text in tree.iter(f"{SVG}text")]
