"""Job files: their models, and the loader that reports every problem at once with its line."""

from tilefab.config.loader import JobFile, load_job
from tilefab.config.models import Job

__all__ = ["Job", "JobFile", "load_job"]
