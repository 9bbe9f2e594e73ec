"""Licences compatible with Apache-2.0, and manual findings on packages whose metadata state no licence."""

from dataclasses import dataclass

ACCEPTED = frozenset(
    {
        "0BSD",
        "Apache-2.0",
        "Apache-2.0 WITH LLVM-exception",
        "BSD-2-Clause",
        "BSD-3-Clause",
        "BSD-3-Clause-Open-MPI",
        "Bitstream-Charter",  # a font
        "CC0-1.0",
        "FTL",
        "GPL-3.0-or-later WITH GCC-exception-3.1",  # with the exception, GCC's output may have any licence
        "IJG",
        "MIT",
        "MIT-0",
        "MIT-CMU",
        "MIT-Modern-Variant",
        "OFL-1.1",  # fonts that may be distributed with any program
        "OpenSSL",
        "PSF-2.0",
        "Qhull",
        "Unicode-3.0",
        "Unicode-DFS-2016",
        "X11",
        "Zlib",
        "libpng-2.0",
        "libtiff",
    }
)
"""Licences of which a distributor keeps the notices, while altd as a whole stays under Apache-2.0.

Licences with further conditions (LGPL, MPL) are not listed: each is accepted for a single package, with a
reason that applies to that package.
"""


@dataclass(frozen=True, slots=True)
class Stated:
    """Licence of a package whose metadata do not give it as an SPDX expression.

    ``declared`` is the statement of the metadata, as in ``Package.declared``: if a release states something
    else, its licence must be checked again. ``requires`` lists its dependencies; used only if the package is
    not installed.
    """

    declared: str
    licence: str
    reason: str
    requires: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Position:
    """Reason why a package is used although its licence has conditions beyond notices."""

    licences: frozenset[str]
    reason: str


@dataclass(frozen=True, slots=True)
class Part:
    """Component under another licence that the wheel of a package contains or its metadata name.

    ``files`` are patterns of paths below ``site-packages``; ``component`` is its name in the metadata (a list
    of parts in CycloneDX, or ``Name:`` in a licence file). ``reason``: why it is accepted, if its licence
    alone is not enough. If not ``is_bundled``, only the metadata name it and the wheel does not contain it.
    """

    package: str
    name: str
    licence: str
    files: tuple[str, ...] = ()
    component: str = ""
    reason: str = ""
    is_bundled: bool = True


PURPOSES = {
    "aiomqtt": "MQTT",
    "asyncua": "OPC UA (extra `opcua`)",
    "gpiod": "lamps on GPIO lines",
    "numpy": "arrays and linear algebra",
    "opencv-python-headless": "pictures: reading, filters, camera models",
    "protobuf": "the payload of Sparkplug",
    "prometheus-client": "the numbers for Prometheus, in its format",
    "wsproto": "pictures over a WebSocket",
    "psycopg": "PostgreSQL, for the ingest (extra `fleet`)",
    "paho-mqtt": "packets, properties and reason codes of MQTT 5",
    "pydantic": "the settings, checked",
    "pygobject": "GigE Vision cameras, through Aravis (extra `aravis`)",
    "pyserial": "serial ports",
    "starlette": "HTTP",
    "uvicorn": "HTTP",
    "matplotlib": "the report's figures and the plot of a replay (extra `report`)",
    "pyarrow": "tables in Parquet (extra `parquet`)",
}
"""The purpose of each package of ``pyproject.toml``."""

STATED = {
    "aiomqtt": Stated("BSD License", "BSD-3-Clause", "`LICENSE` in its wheel is that text"),
    "asyncua": Stated(
        "GNU Lesser General Public License v3 or later; "
        "GNU Lesser General Public License v3 or later (LGPLv3+)",
        "LGPL-3.0-or-later",
        "its metadata, and `COPYING` in its wheel",
    ),
    "contourpy": Stated(
        "BSD 3-Clause License …; BSD License", "BSD-3-Clause", "`LICENSE` in its wheel is that text"
    ),
    "cycler": Stated(
        "Copyright (c) 2015, matplotlib project …; BSD License",
        "BSD-3-Clause",
        "`LICENSE` in its wheel is that text",
    ),
    "kiwisolver": Stated(
        "========================= …; BSD License", "BSD-3-Clause", "`LICENSE` in its wheel: Modified BSD"
    ),
    "matplotlib": Stated(
        "License agreement for matplotlib versions 1.3.0 and later …; Python Software Foundation License",
        "PSF-2.0",
        "`LICENSE` in its wheel is the PSF's text with its own name in it",
    ),
    "opencv-python-headless": Stated(
        "Apache 2.0; Apache Software License",
        "Apache-2.0 AND MIT",
        "OpenCV is Apache-2.0, the packaging around it MIT (`LICENSE.txt`)",
    ),
    "protobuf": Stated("3-Clause BSD License", "BSD-3-Clause", "`LICENSE` in its wheel is that text"),
    "pycairo": Stated("LGPL-2.1-only OR MPL-1.1", "LGPL-2.1-only OR MPL-1.1", "its metadata"),
    "pygobject": Stated(
        "GNU Lesser General Public License v2.1 (LGPLv2.1); "
        "GNU Lesser General Public License v2 or later (LGPLv2+)",
        "LGPL-2.1-or-later",
        "its description and the heads of its sources say LGPL-2.1 or later",
        requires=("pycairo",),
    ),
    "sortedcontainers": Stated(
        "Apache 2.0; Apache Software License", "Apache-2.0", "its description names that version"
    ),
    "pyserial": Stated("BSD; BSD License", "BSD-3-Clause", "its sources name BSD-3-Clause in their heads"),
}

POSITIONS = {
    "asyncua": Position(
        frozenset({"LGPL-3.0-or-later"}),
        "imported, unchanged, from files of its own, which another build can replace",
    ),
    "psycopg": Position(
        frozenset({"LGPL-3.0-only"}),
        "imported, unchanged, from files of its own, which another build can replace",
    ),
    "gpiod": Position(
        frozenset({"LGPL-2.1-or-later"}),
        "imported, unchanged, from files of its own, which another build can replace",
    ),
    "pycairo": Position(
        frozenset({"LGPL-2.1-only"}),
        "needed by PyGObject where that is compiled for tests; altd does not import it, no release has it",
    ),
    "pygobject": Position(
        frozenset({"LGPL-2.1-or-later"}),
        "imported, unchanged; a unit has it from Debian (`python3-gi`), no release has it",
    ),
}

_OWN_FILE = "a library in a file of its own, unchanged, which can be replaced"
_EXCEPTION = "GCC's exception: what is compiled with it may have any licence"
PARTS = (
    Part("numpy", "OpenBLAS", "BSD-3-Clause", ("numpy.libs/libscipy_openblas*",), "OpenBLAS"),
    Part("numpy", "LAPACK, in OpenBLAS", "BSD-3-Clause-Open-MPI", (), "LAPACK"),
    Part(
        "numpy",
        "libgfortran",
        "GPL-3.0-or-later WITH GCC-exception-3.1",
        ("numpy.libs/libgfortran*",),
        "GCC runtime library",
        reason=_EXCEPTION,
    ),
    Part(
        "numpy",
        "libquadmath",
        "LGPL-2.1-or-later",
        ("numpy.libs/libquadmath*",),
        "libquadmath",
        reason=_OWN_FILE,
    ),
    Part(
        "opencv-python-headless",
        "FFmpeg",
        "LGPL-2.1-or-later",
        tuple(f"opencv_python_headless.libs/lib{name}-*" for name in ("avcodec", "avformat", "avutil"))
        + tuple(f"opencv_python_headless.libs/lib{name}-*" for name in ("swresample", "swscale")),
        reason=f"{_OWN_FILE}; built without its GPL parts; altd reads no video",
    ),
    Part("opencv-python-headless", "OpenBLAS", "BSD-3-Clause", ("opencv_python_headless.libs/libopenblas*",)),
    Part(
        "opencv-python-headless",
        "libgfortran",
        "GPL-3.0-or-later WITH GCC-exception-3.1",
        ("opencv_python_headless.libs/libgfortran*",),
        reason=_EXCEPTION,
    ),
    Part(
        "opencv-python-headless",
        "libquadmath",
        "LGPL-2.1-or-later",
        ("opencv_python_headless.libs/libquadmath*",),
        reason=_OWN_FILE,
    ),
    Part(
        "opencv-python-headless",
        "OpenSSL 1.1.1",
        "OpenSSL",
        ("opencv_python_headless.libs/libcrypto-*", "opencv_python_headless.libs/libssl-*"),
        reason="for FFmpeg only",
    ),
    Part("opencv-python-headless", "libaom", "BSD-2-Clause", ("opencv_python_headless.libs/libaom-*",)),
    Part("opencv-python-headless", "libavif", "BSD-2-Clause", ("opencv_python_headless.libs/libavif-*",)),
    Part("opencv-python-headless", "libdrm", "MIT", ("opencv_python_headless.libs/libdrm-*",)),
    Part("opencv-python-headless", "libpng", "libpng-2.0", ("opencv_python_headless.libs/libpng16-*",)),
    Part("opencv-python-headless", "libvpx", "BSD-3-Clause", ("opencv_python_headless.libs/libvpx-*",)),
    Part(
        "matplotlib",
        "BaKoMa fonts",
        "LicenseRef-BaKoMa",
        component="BaKoMa Fonts",
        reason="may be passed on with its notice",
    ),
    Part(
        "matplotlib",
        "Yorick colour maps",
        "LicenseRef-Yorick",
        component="Yorick Colormaps",
        reason="BSD, reworded",
    ),
    Part("cryptography", "OpenSSL", "Apache-2.0", (), "openssl", reason="linked into its extension module"),
    Part("pillow", "brotli", "MIT", ("pillow.libs/libbrotli*",)),
    Part("pillow", "FreeType", "FTL", ("pillow.libs/libfreetype-*",), "FreeType"),
    Part(
        "pillow",
        "FriBiDi",
        "LGPL-2.1-or-later",
        component="FriBiDi",
        reason="not in its wheel; used where the computer has it, for text that altd does not write",
        is_bundled=False,
    ),
    Part("pillow", "HarfBuzz", "MIT-Modern-Variant", ("pillow.libs/libharfbuzz-*",)),
    Part("pillow", "libavif", "BSD-2-Clause", ("pillow.libs/libavif-*",), "libavif"),
    Part(
        "pillow",
        "libimagequant",
        "GPL-3.0-or-later",
        component="libimagequant",
        reason="not in its wheel, which is built without it",
        is_bundled=False,
    ),
    Part("pillow", "libjpeg-turbo", "IJG AND BSD-3-Clause", ("pillow.libs/libjpeg-*",)),
    Part("pillow", "liblzma", "0BSD", ("pillow.libs/liblzma-*",)),
    Part("pillow", "libpng", "libpng-2.0", ("pillow.libs/libpng16-*",)),
    Part("pillow", "libtiff", "libtiff", ("pillow.libs/libtiff-*",), "libtiff"),
    Part(
        "pillow", "libwebp", "BSD-3-Clause", ("pillow.libs/libwebp*", "pillow.libs/libsharpyuv-*"), "libwebp"
    ),
    Part("pillow", "Little CMS", "MIT", ("pillow.libs/liblcms2-*",), "Little CMS 2"),
    Part("pillow", "OpenJPEG", "BSD-2-Clause", ("pillow.libs/libopenjp2-*",), "OpenJPEG"),
    Part("pillow", "X11 libraries", "X11", ("pillow.libs/libxcb-*", "pillow.libs/libXau-*"), "libxcb"),
    Part("pillow", "Zstandard", "BSD-3-Clause OR GPL-2.0-only", ("pillow.libs/libzstd-*",)),
)
"""Components of the PyPI wheels for x86_64 whose file or licence needs an explanation. The other components
are in the wheels' own lists, which are also read."""

TEXTS = {
    ("asyncua", "LGPL"): "its own",
    ("gpiod", "LGPL"): "its own",
    ("psycopg", "LGPL"): "its own",
    ("numpy", "GPL"): "libgfortran's, with GCC's exception",
    ("opencv-python-headless", "LGPL"): "FFmpeg's; another is of Qt, which only wheels with windows have",
    ("opencv-python-headless", "MPL"): "libsrt's, which only the wheels for macOS have",
}
"""Owners of the complete LGPL, GPL and MPL texts in a package's licence files, by package and licence."""
