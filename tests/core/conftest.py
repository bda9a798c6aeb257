"""Crowds of a few hundred agents take the way of many, for judges that look at each agent."""

import pytest
from crowd_lod_extension.crowd_lod.world import morton_order


@pytest.fixture
def in_blocks(monkeypatch):
    """Agents are tested block by block, however few."""
    monkeypatch.setattr(morton_order, "FEWEST", 1)


@pytest.fixture(params=[True, False], ids=["blocks", "each agent"])
def blocks(request, monkeypatch):
    """Whether agents are tested block by block; both are tried."""
    monkeypatch.setattr(morton_order, "FEWEST", 1 if request.param else 10**9)
    return request.param
