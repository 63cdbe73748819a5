"""Blocks of SBF, encoded field by field: Septentrio mosaic-X5 reference guide, chapter 4."""

from __future__ import annotations

import math
import struct
from binascii import crc_hqx
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from camber.formats.broadcast.ephemeris_fields import FIELDS, integers_from_ephemeris, system_week
from camber.formats.observations import (
    SPEED_OF_LIGHT_M_S,
    Ephemeris,
    GlonassEphemeris,
    ObservationEpoch,
    carrier_hz,
    signal_name,
)
from camber.formats.sbf.signal_numbers import SATELLITE_OF_SVID, SIGNALS
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK

MEAS_EPOCH, PVT_GEODETIC, POS_COV_GEODETIC, VEL_COV_GEODETIC, END_OF_PVT = 4027, 4007, 5906, 5908, 5921
RF_STATUS, GAL_AUTH_STATUS = 4092, 4245
GPS_NAV, GAL_NAV, BDS_NAV, QZS_NAV, GPS_ION = 5891, 4002, 4081, 4095, 5893
GLO_NAV = 4004
NO_FLOAT = -2e10
"""A float that means "not available"."""

_ORBIT = "C_rs f,DEL_N f,M_0 d,C_uc f,e d,C_us f,SQRT_A d,t_oe I,C_ic f,OMEGA_0 d,C_is f,i_0 d,C_rc f,omega d"
_ORBIT += ",OMEGADOT f,IDOT f,WNt_oc H,WNt_oe H"
_GPS = "PRN B,Reserved B,WN H,CAorPonL2 B,URA B,health B,L2DataFlag B,IODC H,IODE2 B,IODE3 B,FitIntFlg B,"
_GPS += "Reserved2 B,T_gd f,t_oc I,a_f2 f,a_f1 f,a_f0 f," + _ORBIT
LAYOUTS = {
    PVT_GEODETIC: "Mode B,Error B,Latitude d,Longitude d,Height d,Undulation f,Vn f,Ve f,Vu f,COG f,RxClkBias d,"
    "RxClkDrift f,TimeSystem B,Datum B,NrSV B,WACorrInfo B,ReferenceID H,MeanCorrAge H,SignalInfo I,AlertFlag B,"
    "NrBases B,PPPInfo H,Latency H,HAccuracy H,VAccuracy H,Misc B",
    POS_COV_GEODETIC: "Mode B,Error B,Cov_latlat f,Cov_lonlon f,Cov_hgthgt f,Cov_bb f,Cov_latlon f,Cov_lathgt f,"
    "Cov_latb f,Cov_lonhgt f,Cov_lonb f,Cov_hb f",
    VEL_COV_GEODETIC: "Mode B,Error B,Cov_VnVn f,Cov_VeVe f,Cov_VuVu f,Cov_DtDt f,Cov_VnVe f,Cov_VnVu f,"
    "Cov_VnDt f,Cov_VeVu f,Cov_VeDt f,Cov_VuDt f",
    END_OF_PVT: "",
    GAL_AUTH_STATUS: "OSNMAStatus H,TrustedTimeDelta f,GalActiveMask Q,GalAuthenticMask Q,GpsActiveMask Q,"
    "GpsAuthenticMask Q",
    GPS_NAV: _GPS,
    QZS_NAV: _GPS,
    GAL_NAV: "SVID B,Source B,SQRT_A d,M_0 d,e d,i_0 d,omega d,OMEGA_0 d,OMEGADOT f,IDOT f,DEL_N f,C_uc f,C_us f,"
    "C_rc f,C_rs f,C_ic f,C_is f,t_oe I,t_oc I,a_f2 f,a_f1 f,a_f0 d,WNt_oe H,WNt_oc H,IODnav H,Health_OSSOL H,"
    "Health_PRS B,SISA_L1E5a B,SISA_L1E5b B,SISA_L1AE6A B,BGD_L1E5a f,BGD_L1E5b f,BGD_L1AE6A f,CNAVenc B",
    BDS_NAV: "PRN B,Reserved B,WN H,URA B,SatH1 B,IODC B,IODE B,Reserved2 H,T_GD1 f,T_GD2 f,t_oc I,a_f2 f,a_f1 f,"
    "a_f0 f," + _ORBIT,
    GLO_NAV: "SVID B,FreqNr B,X d,Y d,Z d,Dx f,Dy f,Dz f,Ddx f,Ddy f,Ddz f,gamma f,tau f,dtau f,t_oe I,WN_toe H,"
    "P1 B,P2 B,E B,B B,tb H,M B,P B,l B,P4 B,N_T H,F_T H,C B",
    GPS_ION: "PRN B,Reserved B,alpha_0 f,alpha_1 f,alpha_2 f,alpha_3 f,beta_0 f,beta_1 f,beta_2 f,beta_3 f",
}
"""By block number: name and `struct` code of each field after TOW and WNc. Fields that are not given are zero."""


def sbf_frame(number: int, body: bytes, *, revision: int = 0) -> bytes:
    """Return sync characters, CRC, id, length and body, padded to a multiple of four bytes."""
    padded = body + bytes(-len(body) % 4)
    rest = struct.pack("<HH", number | revision << 13, 8 + len(padded)) + padded
    return b"$@" + struct.pack("<H", crc_hqx(rest, 0)) + rest


def time_stamp(time_ns: int | None) -> bytes:
    """Return TOW [ms] and WNc of a GPS time; None: not known."""
    if time_ns is None:
        return struct.pack("<IH", 0xFFFFFFFF, 0xFFFF)
    week, of_week_ns = divmod(time_ns, NS_PER_WEEK)
    return struct.pack("<IH", of_week_ns // 1_000_000, week)


def sbf_block(number: int, time_ns: int | None, *, revision: int = 0, **fields: Any) -> bytes:
    """Return a block of `LAYOUTS` with these fields."""
    body = time_stamp(time_ns)
    for entry in filter(None, LAYOUTS[number].split(",")):
        name, code = entry.split()
        body += struct.pack("<" + code, fields.pop(name, 0))
    assert not fields, f"no fields {sorted(fields)} in block {number}"
    return sbf_frame(number, body, revision=revision)


def rf_status(time_ns: int | None, bands: Sequence[tuple[int, int, int]] = (), *, flags: int = 0) -> bytes:
    """Return RFStatus of bands (frequency in Hz, bandwidth in kHz, info)."""
    body = time_stamp(time_ns) + struct.pack("<BBB3x", len(bands), 8, flags)
    return sbf_frame(RF_STATUS, body + b"".join(struct.pack("<IHBx", *band) for band in bands))


@dataclass(frozen=True, kw_only=True)
class Tracked:
    """One signal of a satellite in MeasEpoch, in the block's units; None: not available.

    `code_mm`, `phase_mcycles` (without the code), `doppler_tmhz` (0.1 mHz), `cn0_quarters` and `lock_s` as encoded.
    """

    signal: int
    code_mm: int | None
    phase_mcycles: int | None
    doppler_tmhz: int | None
    cn0_quarters: int | None = 120
    lock_s: int | None = 10
    info: int = 0
    antenna: int = 0
    channel: int = 0
    """Of GLONASS alone."""

    def kind(self) -> tuple[int, int]:
        """Return `Type` and `ObsInfo`: signal numbers from 31 on are in both."""
        low, high = (self.signal, 0) if self.signal < 31 else (31, self.signal - 32)
        if self.signal in SIGNALS["R"]:
            high = self.channel + 8
        return low | self.antenna << 5, self.info | high << 3


def meas_epoch(
    time_ns: int | None,
    satellites: Mapping[int, Sequence[Tracked]],
    *,
    common_flags: int = 0,
    clock_jumps: int = 0,
    extra: tuple[int, int] = (0, 0),
) -> bytes:
    """Return MeasEpoch: by SVID its signals, the first one with the full values; others as differences to it.

    The others' code and Doppler are relative: `code_mm` less the first's, `doppler_tmhz` less the first's times the
    ratio of the carriers, both as the caller computes them. `extra`: bytes by which the sub-blocks are longer.
    """
    head = struct.pack("<BBBBBx", len(satellites), 20 + extra[0], 12 + extra[1], common_flags, clock_jumps)
    blocks = b""
    for svid, (first, *others) in satellites.items():
        blocks += _first_signal(svid, first, len(others)) + bytes(extra[0])
        blocks += b"".join(_further_signal(other) + bytes(extra[1]) for other in others)
    return sbf_frame(MEAS_EPOCH, time_stamp(time_ns) + head + blocks, revision=1)


def _first_signal(svid: int, tracked: Tracked, further: int) -> bytes:
    kind, info = tracked.kind()
    code, (msb, lsb) = tracked.code_mm or 0, _split(tracked.phase_mcycles, 65536, (-128, 0))
    doppler = -(2**31) if tracked.doppler_tmhz is None else tracked.doppler_tmhz
    cn0 = 255 if tracked.cn0_quarters is None else tracked.cn0_quarters
    lock = 65535 if tracked.lock_s is None else tracked.lock_s
    head = struct.pack("<BBBBIi", 0, kind, svid, code >> 32, code & 0xFFFFFFFF, doppler)
    return head + struct.pack("<HbBHBB", lsb, msb, cn0, lock, info, further)


def _further_signal(tracked: Tracked) -> bytes:
    kind, info = tracked.kind()
    code_msb, code_lsb = _split(tracked.code_mm, 65536, (-4, 0))
    phase_msb, phase_lsb = _split(tracked.phase_mcycles, 65536, (-128, 0))
    doppler_msb, doppler_lsb = _split(tracked.doppler_tmhz, 65536, (-16, 0))
    cn0 = 255 if tracked.cn0_quarters is None else tracked.cn0_quarters
    lock = 255 if tracked.lock_s is None else tracked.lock_s
    offsets = (code_msb & 7) | (doppler_msb & 31) << 3
    return struct.pack(
        "<BBBBbBHHH", kind, lock, cn0, offsets, phase_msb, info, code_lsb, phase_lsb, doppler_lsb
    )


def _split(value: int | None, unit: int, missing: tuple[int, int]) -> tuple[int, int]:
    return missing if value is None else (math.floor(value / unit), value % unit)


def measurements_block(epoch: ObservationEpoch) -> bytes:
    """Return MeasEpoch of the observations, rounded to its resolutions; signals without a pseudorange are left out."""
    groups: dict[int, list[int]] = {}
    for row in np.flatnonzero(~np.isnan(epoch.pseudorange_m)).tolist():
        groups.setdefault(svid_of(int(epoch.satellite[row])), []).append(row)
    blocks = {}
    for svid, (first, *others) in groups.items():
        code_mm = round(float(epoch.pseudorange_m[first]) * 1000.0)
        doppler_hz = float(epoch.doppler_hz[first])
        head = _tracked(epoch, first, (code_mm, 0), 0.0)
        carrier_hz = _carrier_hz(epoch, first)
        further = [
            _tracked(
                epoch, row, (round(float(epoch.pseudorange_m[row]) * 1000.0), code_mm), doppler_hz * ratio
            )
            for row in others
            for ratio in (_carrier_hz(epoch, row) / carrier_hz,)
        ]
        blocks[svid] = [head, *further]
    return meas_epoch(epoch.time_ns, blocks)


def svid_of(satellite: int) -> int:
    """Return Septentrio's number of a satellite."""
    return next(k for k in range(256) if SATELLITE_OF_SVID[k] == satellite)


def _carrier_hz(epoch: ObservationEpoch, row: int) -> float:
    return carrier_hz(chr(int(epoch.satellite[row]) >> 8), signal_name(int(epoch.signal[row])))


def _tracked(epoch: ObservationEpoch, row: int, codes_mm: tuple[int, int], doppler_hz: float) -> Tracked:
    numbers = SIGNALS[chr(int(epoch.satellite[row]) >> 8)]
    number = next(k for k, name in numbers.items() if name == signal_name(int(epoch.signal[row])))
    code_mm, base_mm = codes_mm
    cycles = code_mm / 1000.0 * _carrier_hz(epoch, row) / SPEED_OF_LIGHT_M_S
    phase, doppler, cn0 = (
        float(column[row]) for column in (epoch.carrier_phase_cycles, epoch.doppler_hz, epoch.cn0_dbhz)
    )
    lock_s, limit_s = float(epoch.lock_time_s[row]), 65534 if base_mm == 0 else 254
    return Tracked(
        signal=number,
        code_mm=code_mm - base_mm,
        phase_mcycles=None if math.isnan(phase) else round((phase - cycles) * 1000.0),
        doppler_tmhz=None if math.isnan(doppler - doppler_hz) else round((doppler - doppler_hz) * 1e4),
        cn0_quarters=None if math.isnan(cn0) else round((cn0 - (0.0 if number in (1, 2) else 10.0)) * 4.0),
        lock_s=None if math.isnan(lock_s) else min(int(lock_s), limit_s),
        info=4 if epoch.half_cycle[row] else 0,
    )


def ephemeris_block(ephemeris: Ephemeris, time_ns: int, *, source: int = 2, **changes: Any) -> bytes:
    """Return GPSNav, QZSNav, BDSNav or GALNav (`source` 2: I/NAV, 16: F/NAV), from the transmitted integers.

    `changes` replace fields of the block.
    """
    system, svid = chr(ephemeris.satellite >> 8), svid_of(ephemeris.satellite)
    integers = integers_from_ephemeris(ephemeris)

    def value(name: str) -> float:
        turn = math.pi if "_rad" in name else 1.0
        return integers[name] * (FIELDS[system][name].resolution / turn)

    orbit = {block: value(name) for name, block in _ORBIT_FIELDS.items()}
    orbit |= {"t_oe": int(orbit["t_oe"]), "t_oc": int(orbit["t_oc"])}
    # Galileo's are those of GPS.
    weeks = (
        system_week("G" if system == "E" else system, t)[0] for t in (ephemeris.toe_ns, ephemeris.toc_ns)
    )
    orbit |= dict(zip(("WNt_oe", "WNt_oc"), weeks, strict=True))
    if system == "E":
        health = [integers[f"{s}_{kind}"] for s in ("e1b", "e5b", "e5a") for kind in ("invalid", "health")]
        bits = sum((1 | health[2 * k] << 1 | health[2 * k + 1] << 2) << 4 * k for k in range(3))
        fields = {"SVID": svid, "Source": source, "IODnav": integers["iode"], "Health_OSSOL": bits}
        fields |= {"SISA_L1E5a": integers["accuracy"], "SISA_L1E5b": integers["accuracy"]}
        fields |= {"BGD_L1E5a": value("bgd_e5a_s"), "BGD_L1E5b": value("bgd_e5b_s"), "BGD_L1AE6A": NO_FLOAT}
        return sbf_block(GAL_NAV, time_ns, **(orbit | fields | changes))
    common = {"PRN": svid, "URA": integers["accuracy"], "WN": integers["week"]}
    if system == "C":
        fields = {"SatH1": integers["health"], "IODC": integers["aodc"], "IODE": integers["iode"]}
        fields |= {"T_GD1": value("tgd1_s"), "T_GD2": value("tgd2_s")}
        return sbf_block(BDS_NAV, time_ns, **(orbit | common | fields | changes))
    fields = {"health": integers["health"], "IODC": integers["iodc"], "FitIntFlg": integers["fit"]}
    fields |= {"IODE2": integers["iode"], "IODE3": integers["iode"], "T_gd": value("tgd_s"), "CAorPonL2": 1}
    return sbf_block(GPS_NAV if system == "G" else QZS_NAV, time_ns, **(orbit | common | fields | changes))


def glonass_block(e: GlonassEphemeris, time_ns: int, **changes: int) -> bytes:
    """Return GLONav."""
    places = {name: v / 1e3 for name, v in zip("XYZ", e.position_m, strict=True)}
    places |= {f"D{name}": v / 1e3 for name, v in zip("xyz", e.velocity_m_s, strict=True)}
    places |= {f"Dd{name}": v / 1e3 for name, v in zip("xyz", e.acceleration_m_s2, strict=True)}
    week, of_week_ns = divmod(e.toe_ns, NS_PER_WEEK)
    fields = {"SVID": svid_of(e.satellite), "FreqNr": e.channel + 8, "gamma": e.clock[1], "tau": -e.clock[0]}
    fields |= {"dtau": e.group_delay_s, "t_oe": of_week_ns // NS_PER_SECOND, "WN_toe": week}
    fields |= {"B": e.health << 2, "tb": e.iode * 15}
    return sbf_block(GLO_NAV, time_ns, **(places | fields | changes))


_ORBIT_FIELDS = {
    "crs_m": "C_rs",
    "mean_motion_difference_rad_s": "DEL_N",
    "mean_anomaly_rad": "M_0",
    "cuc": "C_uc",
    "eccentricity": "e",
    "cus": "C_us",
    "sqrt_a": "SQRT_A",
    "toe_s": "t_oe",
    "cic": "C_ic",
    "ascending_node_rad": "OMEGA_0",
    "cis": "C_is",
    "inclination_rad": "i_0",
    "crc_m": "C_rc",
    "perigee_rad": "omega",
    "ascending_node_rate_rad_s": "OMEGADOT",
    "inclination_rate_rad_s": "IDOT",
    "toc_s": "t_oc",
    "af2": "a_f2",
    "af1": "a_f1",
    "af0_s": "a_f0",
}
