"""What a sweep would do, or has done, from the configuration and the manifest alone."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from wobblesim.config import SweepConfig
from wobblesim.study.plan import lane_steps, study
from wobblesim.study.store import Store, read_manifest


def preview(config: SweepConfig, folder: Path) -> list[dict[str, Any]]:
    """One row a condition: the runs ``wanted``, ``present``, ``missing``, and the ``lane_steps`` of those, at most.

    Raises
    ------
    PlanError
        If a condition cannot be run.
    StoreError
        If the folder holds results of other settings.
    """
    laid_out = study(config)
    store = Store(folder, read_manifest(folder))
    store.check(laid_out.written)
    present = Counter(condition for condition, seed in store.present() if seed in set(laid_out.seeds))
    rows = []
    for condition, setup in laid_out.setups.items():
        missing = len(laid_out.seeds) - present[condition]
        rows.append(
            {
                "condition": condition,
                "wanted": len(laid_out.seeds),
                "present": present[condition],
                "missing": missing,
                "lane_steps": missing * lane_steps(setup),
            }
        )
    return rows
