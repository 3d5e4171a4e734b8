"""The life of a job: plan, prepare, convert, render, record, resume, report."""

from tilefab.pipeline.main_job import JobOutcome, do_job
from tilefab.pipeline.plan import Plan, plan_job
from tilefab.pipeline.run import RunResult, run_job

__all__ = ["JobOutcome", "Plan", "RunResult", "do_job", "plan_job", "run_job"]
