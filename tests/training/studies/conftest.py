"""The networks of ablations are known while a test of them runs, and to no test after it."""

import pytest

from arm_blender import networks
from training.studies.ablated_albedo import AblatedConfig, ablated


@pytest.fixture(autouse=True)
def ablations_known(monkeypatch):
    monkeypatch.setitem(networks.NETWORKS["instant_albedo"], AblatedConfig, ablated)
