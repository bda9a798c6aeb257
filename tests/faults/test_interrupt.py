"""Ctrl-C at any moment of any command."""

import pytest

pytestmark = pytest.mark.faults
