"""Which message of the bus is made of which UBX message, where one follows from one."""

from __future__ import annotations

from collections.abc import Callable

from google.protobuf.message import Message

from tramstream import keys
from tramstream.bridges.gnss import fusion_messages as fusion
from tramstream.bridges.gnss import messages, state_messages
from tramstream.bridges.gnss import satellite_messages as signals
from tramstream.bridges.gnss.ubx import UbxMessage

Builder = Callable[[UbxMessage, int | None], Message]

BUILDERS: dict[str, tuple[keys.Key, Builder]] = {
    "NAV-ATT": (keys.GNSS_ATTITUDE, messages.attitude),
    "HNR-ATT": (keys.GNSS_ATTITUDE, messages.attitude),
    "NAV-COV": (keys.GNSS_COVARIANCE, messages.covariance),
    "NAV-HPPOSLLH": (keys.GNSS_POSITION, messages.position),
    "NAV-POSLLH": (keys.GNSS_POSITION, messages.position),
    "NAV-TIMEGPS": (keys.GNSS_TIME, messages.time_gps),
    "NAV-TIMELS": (keys.GNSS_TIME, messages.time_leap),
    "NAV-TIMEUTC": (keys.GNSS_TIME, messages.time_utc),
    "NAV-SVINFO": (keys.GNSS_SATELLITES, signals.space_vehicles),
    "NAV-SAT": (keys.GNSS_SATELLITES, signals.satellites),
    "NAV-SIG": (keys.GNSS_SIGNALS, signals.signals),
    "TIM-TP": (keys.GNSS_PULSE, messages.pulse),
    "RXM-RAWX": (keys.GNSS_MEASUREMENTS, signals.measurements),
    "RXM-RAW": (keys.GNSS_MEASUREMENTS, signals.raw_measurements),
    "RXM-SFRBX": (keys.GNSS_SUBFRAME, signals.subframe),
    "ESF-MEAS": (keys.GNSS_ESF_MEASUREMENTS, fusion.esf_measurements),
    "ESF-RAW": (keys.GNSS_ESF_MEASUREMENTS, fusion.esf_measurements),
    "ESF-STATUS": (keys.GNSS_ESF_STATUS, fusion.esf_status),
    "ESF-INS": (keys.GNSS_ESF_INERTIAL, fusion.esf_inertial),
    "HNR-INS": (keys.GNSS_ESF_INERTIAL, fusion.esf_inertial),
    "ESF-ALG": (keys.GNSS_ESF_ALIGNMENT, fusion.esf_alignment),
    "NAV-PL": (keys.GNSS_PROTECTION, state_messages.protection),
    "NAV-RELPOSNED": (keys.GNSS_BASELINE, state_messages.baseline),
    "NAV-DOP": (keys.GNSS_DILUTION, state_messages.dilution),
    "NAV-CLOCK": (keys.GNSS_OSCILLATOR, state_messages.oscillator),
    "NAV-STATUS": (keys.GNSS_INTERFERENCE, state_messages.status),
    "MON-RF": (keys.GNSS_INTERFERENCE, state_messages.radio),
    "MON-HW": (keys.GNSS_INTERFERENCE, state_messages.hardware),
    "SEC-SIG": (keys.GNSS_INTERFERENCE, state_messages.signal_security),
    "MON-SPAN": (keys.GNSS_SPECTRUM, state_messages.spectrum),
    "RXM-RTCM": (keys.GNSS_CORRECTION, state_messages.rtcm_input),
    "RXM-COR": (keys.GNSS_CORRECTION, state_messages.correction_input),
}
"""UBX type to key and builder, where one message follows from one."""
