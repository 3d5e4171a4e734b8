"""The devices of the line, as the host sees them: what is asked and told on their wires, and nothing of what for."""

from tilefab.devices.backoff import Backoff
from tilefab.devices.crc import joined_crc32
from tilefab.devices.endpoints import parse_endpoint
from tilefab.devices.gauge import GaugeReading, GaugeSession
from tilefab.devices.kiln import KilnCommand, KilnSession, KilnStatus
from tilefab.devices.plc import PlcCommand, PlcSession, PlcStatus
from tilefab.devices.printer import PrinterSession
from tilefab.devices.printer_data import PrinterDataLink
from tilefab.devices.printer_messages import ArmStatus, DisarmStatus, OutcomeState
from tilefab.devices.printer_values import (
    ArmCommand,
    ArmReply,
    Detection,
    Outcome,
    PrinterIdentity,
    PrinterStatus,
)

__all__ = [
    "ArmCommand",
    "ArmReply",
    "ArmStatus",
    "Backoff",
    "Detection",
    "DisarmStatus",
    "GaugeReading",
    "GaugeSession",
    "KilnCommand",
    "KilnSession",
    "KilnStatus",
    "Outcome",
    "OutcomeState",
    "PlcCommand",
    "PlcSession",
    "PlcStatus",
    "PrinterDataLink",
    "PrinterIdentity",
    "PrinterSession",
    "PrinterStatus",
    "joined_crc32",
    "parse_endpoint",
]
