"""A daemon's documents on a made-up unit, written by hand after docs/http.md."""

from typing import Any

TARGETS: dict[str, Any] = {
    "area_mm": [140.0, 110.0],
    "targets": [
        {"name": "front", "z_mm": 0.0, "valid_mm": [[-72, -55], [72, -55], [72, 55], [-72, 55]]},
        {"name": "rear", "z_mm": 280.0, "valid_mm": [[-72, 0], [0, -55], [72, 0], [0, 55]]},
    ],
}

CHECK: dict[str, Any] = {
    "verdict": "good",
    "reasons": [],
    "time": "2026-11-20T08:10:00.000Z",
    "number": 3,
    "parts": [
        {
            "of": "front",
            "verdict": "good",
            "unit": "mm",
            "error": 0.001,
            "sigma": 0.0015,
            "suspect": 0.03,
            "bad": 0.1,
        }
    ],
    "targets": {
        "front": {
            "leds_expected": 6,
            "leds_found": 6,
            "shift_px": [0.012, -0.004],
            "turn_deg": 0.0002,
            "scale_ppm": 3.1,
            "rms_px": 0.011,
            "significance": 1.4,
            "is_similarity": True,
            "leds": ["used"] * 6,
            "foreign_px": [],
            "detail": "",
        }
    },
}


def calibrated(name: str, left_out_px: float | None, max_mm: float, flat: str | None) -> dict[str, Any]:
    return {
        "name": name,
        "z_mm": 0.0,
        "simulated": False,
        "camera": {"serial": None, "model": None, "driver": None},
        "width": 752,
        "height": 480,
        "map": "lens",
        "x_mm": [-84.0, 84.0],
        "y_mm": [-70.0, 70.0],
        "left_out_px": left_out_px,
        "residuals": {"mean_mm": 0.004, "std_mm": 0.002, "max_mm": max_mm},
        "repeatability_px": [0.01, 0.01],
        "leds": 4,
        "cross_check": {"map": "tensor 4 × 4", "left_out_px": 0.03, "bound_px": 0.1, "largest_px": 0.05},
        "flat": flat,
        "fingerprint": None,
    }


CALIBRATION: dict[str, Any] = {
    "targets": [calibrated("front", 0.02104, 0.0123, "recording"), calibrated("rear", None, 0.0101, None)]
}

DUSTY: dict[str, Any] = {
    "code": "dusty",
    "signal": "maintenance_required",
    "of": "front",
    "active": True,
    "for_s": 75.0,
    "times": 1,
    "brief": "dust is seen under the spot",
    "remedy": "clean the window; if it remains on one target only, that target",
    "detail": "0.08 % of the area under the spot",
}
SPOT_MISSING: dict[str, Any] = {
    "code": "spot_missing",
    "signal": "out_of_specification",
    "of": "rear",
    "active": False,
    "for_s": 1.5,
    "times": 4,
    "brief": "no laser spot",
    "remedy": "switch the laser on and check that its beam enters the window",
    "detail": "",
}


def measurement(**changes: Any) -> dict[str, Any]:
    """A valid one, 0.5 s old; with these keys otherwise."""
    document: dict[str, Any] = {
        "sequence": 160,
        "time": "2026-11-20T08:15:30.125Z",
        "t_s": 8.0,
        "frames": 20,
        "valid": True,
        "status": [],
        "x_mm": 35.0123,
        "y_mm": -27.5,
        "yaw_deg": 1.1459,
        "pitch_deg": -1.7184,
        "yaw_mm_per_m": 20.0024,
        "pitch_mm_per_m": -30.0007,
        "roll_deg": None,
        "sigma": {"x_mm": 0.004, "y_mm": 0.004, "yaw_deg": 0.0011, "pitch_deg": 0.0011},
        "front": {"x_mm": 35.0123, "y_mm": -27.5},
        "rear": {"x_mm": -36.0, "y_mm": 13.75},
        "sigma_now": {"x_mm": 0.0288, "y_mm": 0.0151, "yaw_deg": 0.00196, "pitch_deg": 0.00161},
        "rates": {"x_mm_per_s": 0.0512, "sigma": {"x_mm_per_s": 0.0031}},
        "cross_check": {
            "yaw_deg": 1.1475,
            "pitch_deg": -1.7169,
            "targets": {
                "front": {"u_px": 234.952, "v_px": 350.052, "x_mm": 35.0109, "y_mm": -27.4985},
                "rear": {"u_px": 231.452, "v_px": 185.052, "x_mm": -35.998, "y_mm": 13.7521},
            },
        },
        "unit": "1E4B2D8E",
        "session": "5C1E90A7",
        "message": 4711,
        "published": 161,
        "clock_ms": 345678,
        "age_s": 0.5,
        "crc32": "5D556B0F",
    }
    return document | changes


def invalid(*status: str) -> dict[str, Any]:
    """One without numbers, for these reasons."""
    nothing: dict[str, None] = dict.fromkeys(("x_mm", "y_mm", "yaw_deg", "pitch_deg"))
    place: dict[str, None] = {"x_mm": None, "y_mm": None}
    return measurement(
        valid=False,
        status=list(status),
        **nothing,
        yaw_mm_per_m=None,
        pitch_mm_per_m=None,
        sigma=nothing,
        sigma_now=nothing,
        front=place,
        rear=place,
    )


def status(*causes: dict[str, Any], signal: str = "good", **components: dict[str, Any]) -> dict[str, Any]:
    """The unit's state with these causes and further components."""
    span = {
        "share": 0.99996,
        "valid_s": 3599.9,
        "observed_s": 3600.0,
        "lost_s": {"stale": 0.1},
        "since": None,
    }
    return {
        "version": "0.1.0",
        "serial": "ALT-0007",
        "unit_number": "1E4B2D8E",
        "calibration": "2026-11-02, workshop, stage 2",
        "spot_fit": "compiled",
        "operating_hours": 812.5,
        "state": {"signal": signal, "number": 0, "for_s": 7384.0, "causes": list(causes)},
        "availability": {
            "last_hour": span,
            "last_day": span | {"observed_s": 86_400.0},
            "last_31_days": span | {"observed_s": 31 * 86_400.0},
            "since_start": span | {"share": None},
        },
        "components": {
            "camera front": {"state": "ok", "message": "", "for_s": 7384.0, "frames": 147_680},
            "measuring": {"state": "ok", "message": "front: spot at u 1 v 2 px", "for_s": 7383.5},
            **components,
        },
    }
