"""Kernel interface of a camera: structures, call numbers, constants.

Written from the kernel's user-space headers <linux/videodev2.h> and <linux/v4l2-controls.h>, Copyright (C)
1999-2012 the contributors, which are "(GPL-2.0+ WITH Linux-syscall-note) OR BSD-3-Clause"; used here under
the BSD-3-Clause, whose text is in ``LICENSE.videodev2`` beside this file. The names are the kernel's, which
explains their meaning (Linux Media Infrastructure userspace API, part I). Only the parts that altd uses are
here: a field whose name begins with ``_`` replaces several that it does not use.

Call numbers are those of <asm-generic/ioctl.h>, as on x86 and ARM. ``tests/unit/devices/test_v4l2.py``
compares all of it with the headers, by a compiler.
"""

from __future__ import annotations

import ctypes
from ctypes import (
    c_char,
    c_int,
    c_int32,
    c_int64,
    c_long,
    c_uint8,
    c_uint16,
    c_uint32,
    c_uint64,
    c_ulong,
    c_void_p,
)

V4L2_CAP_VIDEO_CAPTURE = 0x0000_0001
V4L2_CAP_VIDEO_CAPTURE_MPLANE = 0x0000_1000
V4L2_CAP_STREAMING = 0x0400_0000
V4L2_CAP_DEVICE_CAPS = 0x8000_0000
V4L2_CAP_TIMEPERFRAME = 0x1000

V4L2_BUF_TYPE_VIDEO_CAPTURE = 1
V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE = 9
V4L2_MEMORY_MMAP = 1
V4L2_BUF_FLAG_ERROR = 0x0000_0040
V4L2_BUF_FLAG_TIMESTAMP_MASK = 0x0000_E000
V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC = 0x0000_2000
V4L2_BUF_FLAG_TSTAMP_SRC_MASK = 0x0007_0000
V4L2_BUF_FLAG_TSTAMP_SRC_SOE = 0x0001_0000

V4L2_FRMSIZE_TYPE_DISCRETE = 1
V4L2_FRMIVAL_TYPE_DISCRETE = 1

V4L2_CTRL_TYPE_INTEGER = 1
V4L2_CTRL_TYPE_BOOLEAN = 2
V4L2_CTRL_TYPE_MENU = 3
V4L2_CTRL_TYPE_BUTTON = 4
V4L2_CTRL_TYPE_BITMASK = 8
V4L2_CTRL_TYPE_INTEGER_MENU = 9
V4L2_CTRL_FLAG_DISABLED = 0x0001
V4L2_CTRL_FLAG_READ_ONLY = 0x0004
V4L2_CTRL_FLAG_WRITE_ONLY = 0x0040
V4L2_CTRL_FLAG_NEXT_CTRL = 0x8000_0000
V4L2_CID_AUTO_WHITE_BALANCE = 0x0098_090C
V4L2_CID_AUTOGAIN = 0x0098_0912
V4L2_CID_EXPOSURE_AUTO = 0x009A_0901
V4L2_CID_EXPOSURE_ABSOLUTE = 0x009A_0902
V4L2_CID_EXPOSURE_AUTO_PRIORITY = 0x009A_0903
V4L2_CID_FOCUS_AUTO = 0x009A_090C


class v4l2_capability(ctypes.Structure):
    """Identity of a device; texts end at their first NUL."""

    _fields_ = (
        ("driver", c_char * 16),
        ("card", c_char * 32),
        ("bus_info", c_char * 32),
        ("version", c_uint32),
        ("capabilities", c_uint32),
        ("device_caps", c_uint32),
        ("_reserved", c_uint32 * 3),
    )


class v4l2_fract(ctypes.Structure):
    """A fraction, such as the seconds from frame to frame."""

    _fields_ = (("numerator", c_uint32), ("denominator", c_uint32))


class v4l2_pix_format(ctypes.Structure):
    """Layout of a frame in one block of memory."""

    _fields_ = (
        ("width", c_uint32),
        ("height", c_uint32),
        ("pixelformat", c_uint32),
        ("field", c_uint32),
        ("bytesperline", c_uint32),
        ("sizeimage", c_uint32),
        ("_colours", c_uint32 * 6),
    )


class v4l2_plane_pix_format(ctypes.Structure):
    """Layout of one of several blocks of memory that a frame is in."""

    _pack_ = 1
    _fields_ = (("sizeimage", c_uint32), ("bytesperline", c_uint32), ("_reserved", c_uint16 * 6))


class v4l2_pix_format_mplane(ctypes.Structure):
    """Layout of a frame in up to eight blocks of memory, called planes."""

    _pack_ = 1
    _fields_ = (
        ("width", c_uint32),
        ("height", c_uint32),
        ("pixelformat", c_uint32),
        ("field", c_uint32),
        ("_colorspace", c_uint32),
        ("plane_fmt", v4l2_plane_pix_format * 8),
        ("num_planes", c_uint8),
        ("_colours", c_uint8 * 11),
    )


class _Format(ctypes.Union):
    _fields_ = (
        ("pix", v4l2_pix_format),
        ("pix_mp", v4l2_pix_format_mplane),
        ("_raw_data", c_uint8 * 200),
        ("_window", c_void_p),  # another member has pointers, which set the union's alignment
    )


class v4l2_format(ctypes.Structure):
    """Format of a buffer type."""

    _fields_ = (("type", c_uint32), ("fmt", _Format))


class v4l2_fmtdesc(ctypes.Structure):
    """An entry of the list of pixel formats."""

    _fields_ = (
        ("index", c_uint32),
        ("type", c_uint32),
        ("flags", c_uint32),
        ("description", c_char * 32),
        ("pixelformat", c_uint32),
        ("_rest", c_uint32 * 4),
    )


class v4l2_frmsize_discrete(ctypes.Structure):
    """One size of frames."""

    _fields_ = (("width", c_uint32), ("height", c_uint32))


class v4l2_frmsize_stepwise(ctypes.Structure):
    """A range of sizes."""

    _fields_ = (
        ("min_width", c_uint32),
        ("max_width", c_uint32),
        ("step_width", c_uint32),
        ("min_height", c_uint32),
        ("max_height", c_uint32),
        ("step_height", c_uint32),
    )


class _FrameSize(ctypes.Union):
    _fields_ = (("discrete", v4l2_frmsize_discrete), ("stepwise", v4l2_frmsize_stepwise))


class v4l2_frmsizeenum(ctypes.Structure):
    """An entry of the list of sizes."""

    _anonymous_ = ("_size",)
    _fields_ = (
        ("index", c_uint32),
        ("pixel_format", c_uint32),
        ("type", c_uint32),
        ("_size", _FrameSize),
        ("_reserved", c_uint32 * 2),
    )


class v4l2_frmival_stepwise(ctypes.Structure):
    """A range of periods, in seconds."""

    _fields_ = (("min", v4l2_fract), ("max", v4l2_fract), ("step", v4l2_fract))


class _FramePeriod(ctypes.Union):
    _fields_ = (("discrete", v4l2_fract), ("stepwise", v4l2_frmival_stepwise))


class v4l2_frmivalenum(ctypes.Structure):
    """An entry of the list of periods."""

    _anonymous_ = ("_period",)
    _fields_ = (
        ("index", c_uint32),
        ("pixel_format", c_uint32),
        ("width", c_uint32),
        ("height", c_uint32),
        ("type", c_uint32),
        ("_period", _FramePeriod),
        ("_reserved", c_uint32 * 2),
    )


class v4l2_captureparm(ctypes.Structure):
    """Frame rate settings of a camera."""

    _fields_ = (
        ("capability", c_uint32),
        ("capturemode", c_uint32),
        ("timeperframe", v4l2_fract),
        ("_rest", c_uint32 * 6),
    )


class _StreamParameters(ctypes.Union):
    _fields_ = (("capture", v4l2_captureparm), ("_raw_data", c_uint8 * 200))


class v4l2_streamparm(ctypes.Structure):
    """Stream parameters of a buffer type."""

    _fields_ = (("type", c_uint32), ("parm", _StreamParameters))


class v4l2_requestbuffers(ctypes.Structure):
    """Number of buffers requested, and then the number granted."""

    _fields_ = (
        ("count", c_uint32),
        ("type", c_uint32),
        ("memory", c_uint32),
        ("_rest", c_uint32 * 2),
    )


class timeval(ctypes.Structure):
    """An instant in seconds and microseconds."""

    _fields_ = (("tv_sec", c_long), ("tv_usec", c_long))


class _PlaneMemory(ctypes.Union):
    _fields_ = (("mem_offset", c_uint32), ("_userptr", c_ulong))


class v4l2_plane(ctypes.Structure):
    """A plane of a buffer; its picture begins at ``data_offset``, which ``bytesused`` includes."""

    _fields_ = (
        ("bytesused", c_uint32),
        ("length", c_uint32),
        ("m", _PlaneMemory),
        ("data_offset", c_uint32),
        ("_reserved", c_uint32 * 11),
    )


class _Memory(ctypes.Union):
    _fields_ = (("offset", c_uint32), ("_userptr", c_ulong), ("planes", ctypes.POINTER(v4l2_plane)))


class v4l2_buffer(ctypes.Structure):
    """A buffer that driver and program exchange."""

    _fields_ = (
        ("index", c_uint32),
        ("type", c_uint32),
        ("bytesused", c_uint32),
        ("flags", c_uint32),
        ("field", c_uint32),
        ("timestamp", timeval),
        ("_timecode", c_uint32 * 4),
        ("sequence", c_uint32),
        ("memory", c_uint32),
        ("m", _Memory),
        ("length", c_uint32),
        ("_rest", c_uint32 * 2),
    )


class v4l2_control(ctypes.Structure):
    """Value of a control."""

    _fields_ = (("id", c_uint32), ("value", c_int32))


class v4l2_query_ext_ctrl(ctypes.Structure):
    """Description of a control by its driver."""

    _fields_ = (
        ("id", c_uint32),
        ("type", c_uint32),
        ("name", c_char * 32),
        ("minimum", c_int64),
        ("maximum", c_int64),
        ("step", c_uint64),
        ("default_value", c_int64),
        ("flags", c_uint32),
        ("_rest", c_uint32 * 39),
    )


def v4l2_fourcc(characters: str) -> int:
    """Code of a pixel format from its four characters."""
    return int.from_bytes(characters.encode("ascii"), "little")


def _call(direction: int, number: int, argument: type[ctypes.Structure | c_int]) -> int:
    return direction << 30 | ctypes.sizeof(argument) << 16 | ord("V") << 8 | number


_WRITTEN, _READ = 1, 2
"""Directions as seen from the program: the kernel takes the argument, fills it, or both."""
_BOTH = _WRITTEN | _READ

VIDIOC_QUERYCAP = _call(_READ, 0, v4l2_capability)
VIDIOC_ENUM_FMT = _call(_BOTH, 2, v4l2_fmtdesc)
VIDIOC_S_FMT = _call(_BOTH, 5, v4l2_format)
VIDIOC_REQBUFS = _call(_BOTH, 8, v4l2_requestbuffers)
VIDIOC_QUERYBUF = _call(_BOTH, 9, v4l2_buffer)
VIDIOC_QBUF = _call(_BOTH, 15, v4l2_buffer)
VIDIOC_DQBUF = _call(_BOTH, 17, v4l2_buffer)
VIDIOC_STREAMON = _call(_WRITTEN, 18, c_int)
VIDIOC_G_PARM = _call(_BOTH, 21, v4l2_streamparm)
VIDIOC_S_PARM = _call(_BOTH, 22, v4l2_streamparm)
VIDIOC_G_CTRL = _call(_BOTH, 27, v4l2_control)
VIDIOC_S_CTRL = _call(_BOTH, 28, v4l2_control)
VIDIOC_ENUM_FRAMESIZES = _call(_BOTH, 74, v4l2_frmsizeenum)
VIDIOC_ENUM_FRAMEINTERVALS = _call(_BOTH, 75, v4l2_frmivalenum)
VIDIOC_QUERY_EXT_CTRL = _call(_BOTH, 103, v4l2_query_ext_ctrl)
