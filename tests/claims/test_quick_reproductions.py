"""Quick reproductions of the three papers: their jobs run, and all of their claims are tested."""

from __future__ import annotations

from pathlib import Path

import pytest

from gaitsweep.claims.claims_and_verdicts import ClaimVerdict, read_paper
from gaitsweep.claims.reproduce import reproduce

# Jobs left out here: of the waist quadruped those that follow hold after hold or take long to compile, of the
# planar quadruped those that repeat a sweep with another constant.
LONG = {
    "aoi2011": {
        *("runge_kutta", "holds", "beta_holds", "return_map", "beta_branches"),
        *("forced", "forced_footprints", "transition", "feet"),
    },
    "fukuoka2015": {"ramp_slow", "ramp_fast", "loads", "k2", "hip_feedback"},
}

# Half of the starts of each return map, which attractors draw together in half of the cycles.
FEWER = {
    "aoi2011": {
        "branches": {"vary.delta_13.linspace": [2.65, 3.15, 50], "run.after_cycles": 20, "run.crossings": 25}
    }
}

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", ["ambe2021", "aoi2011", "fukuoka2015"])
def test_quick_reproduction(name: str, tmp_path: Path) -> None:
    paper = read_paper(name)
    claims = [claim for claim in paper.claims if not LONG.get(name, set()).intersection(claim.of)]
    jobs = {
        job: run.model_copy(update={"quick": {**(run.quick or {}), **FEWER.get(name, {}).get(job, {})}})
        for job, run in paper.jobs.items()
        if run.quick is not False
    }
    paper = paper.model_copy(update={"claims": claims, "jobs": paper.jobs | jobs})
    result = reproduce(paper, tmp_path, quick=True)
    assert not result.failed
    assert len(result.table) == len(paper.claims)
    assert sum(result.counts.values()) == len(paper.claims)
    missed = result.table.loc[result.table["verdict"] == ClaimVerdict.not_reproduced.value]
    at_finer_steps = [claim.id for claim in paper.claims if claim.step]  # missed there, which is the reason
    unexplained = (missed["tried"].str.strip() == "") & ~missed["id"].isin(at_finer_steps)
    untried = missed.loc[unexplained, ["id", "ours", "allowed"]]
    assert untried.empty, untried.to_string()
    not_judged = result.table.loc[result.table["verdict"] == ClaimVerdict.not_run.value]
    assert not_judged["why"].str.contains("--quick").all()
    text = result.page.read_text()
    assert all(claim.id in text for claim in paper.claims)
