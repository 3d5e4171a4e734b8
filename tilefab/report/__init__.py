"""PDF pages from frozen view models.

Nothing here reads a file or a clock: a report is a pure function of its view model, and equal view models
give equal bytes.
"""

from tilefab.report.build import build_run_report
from tilefab.report.view_model import (
    ChartView,
    ColourView,
    FaceView,
    HistogramView,
    InkView,
    PictureView,
    RunReportView,
    SwatchView,
    TextureMapView,
    contact_faces,
)

__all__ = [
    "ChartView",
    "ColourView",
    "FaceView",
    "HistogramView",
    "InkView",
    "PictureView",
    "RunReportView",
    "SwatchView",
    "TextureMapView",
    "build_run_report",
    "contact_faces",
]
