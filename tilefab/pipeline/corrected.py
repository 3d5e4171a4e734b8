"""A job whose colours are corrected while it is being printed: same faces, other inks.

A correction changes what inks a colour is made of, and nothing else: which part of the stone a face shows, and so the
job's hash, stay. A face's print data are a function of job, face and correction.
"""

from __future__ import annotations

from dataclasses import replace

from tilefab.io.drift_file import DriftFile
from tilefab.pipeline.carried import carried_measurements
from tilefab.pipeline.plan import Plan, hash_of, press_facts, require_drift_of


def corrected_plan(plan: Plan, drift: DriftFile, drift_sha256: str) -> Plan:
    """The same job, printed for a press that has drifted.

    Parameters
    ----------
    plan
        The job as its file says.
    drift, drift_sha256
        How the press has drifted since it was profiled, and the hash of the file that tells it.

    Returns
    -------
    Plan
        With another ``press_key``, so that its map in inks is kept beside those of other corrections; the ``job_hash``
        stays.

    Raises
    ------
    ProfileError
        If the drift is of another press, or the profile carries no measurements to correct with.
    """
    require_drift_of(drift, plan.press_profile, "the correction")
    carried_measurements(plan.press_profile)
    facts = press_facts(plan.job, plan.press_profile, drift_sha256)
    return replace(plan, drift=drift, drift_sha256=drift_sha256, press_key=hash_of(facts))
