"""Logs for tests: the fixtures of this repository, and the shared captures if they are beside the checkout."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CIRCLE = ROOT / "tests" / "fixtures" / "small-circle"
STAMP = "2023-11-14_221320"
CAPTURES = Path(os.environ.get("CSI5300_CAPTURES", ROOT.parent / "shared" / "captures"))
CSITOOL = sorted((CAPTURES / "csitool").glob("*.dat"))


@pytest.fixture
def rx() -> Path:
    return CIRCLE / f"csi_rx_{STAMP}.dat"


@pytest.fixture
def tx() -> Path:
    return CIRCLE / f"csi_tx1_{STAMP}.dat"


@pytest.fixture
def path_csv() -> Path:
    return CIRCLE / f"rx_trajectory_{STAMP}_.csv"


@pytest.fixture
def captures() -> Path:
    if not CAPTURES.is_dir():
        pytest.skip("no captures beside this checkout")
    return CAPTURES
