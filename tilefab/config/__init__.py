"""Job and line files: their models, and the loader that reports every problem at once with its line."""

from tilefab.config.line import Line, LineFile, load_line
from tilefab.config.loader import JobFile, load_job
from tilefab.config.models import Job

__all__ = ["Job", "JobFile", "Line", "LineFile", "load_job", "load_line"]
