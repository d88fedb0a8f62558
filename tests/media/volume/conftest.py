"""Libraries of volumes say nothing by themselves."""

import pytest


@pytest.fixture(autouse=True)
def _silent(capfd):
    """Nothing may be printed by any of these."""
    yield
    out, err = capfd.readouterr()
    assert (out, err) == ("", "")
