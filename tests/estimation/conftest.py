"""Behaviour must not depend on whether a step is compiled: every test here runs both ways."""

import pytest

from tracker.compile import objects


@pytest.fixture(params=["arrays", "compiled"], autouse=True)
def interpretation(request, monkeypatch):
    if request.param == "compiled" and not objects.available():
        pytest.skip("llvmlite is not installed")
    monkeypatch.setenv("TRACKER_COMPILE", "off" if request.param == "arrays" else "on")
    return request.param
