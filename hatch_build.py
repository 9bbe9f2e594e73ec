"""Compiles ``altd/vision/kernel.c`` when altd is built or installed from source.

Without a C compiler altd runs on numpy alone.
"""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SOURCE, LIBRARY = "altd/vision/kernel.c", "altd/vision/libkernel.so"
# no flag that changes results from one processor to another, or the floating-point mode of the process
FLAGS = shlex.split(
    "-std=c11 -O3 -fno-math-errno -fno-trapping-math -fassociative-math -fno-signed-zeros -shared -fPIC"
)


class CompileKernel(BuildHookInterface):  # type: ignore[type-arg]
    """Adds the library to the wheel, which is then one of this platform."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile; a wheel without the library fits every platform."""
        library = Path(self.root, LIBRARY)
        library.unlink(missing_ok=True)
        compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
        if self.target_name != "wheel" or compiler is None:
            return
        command = [compiler, *FLAGS, str(Path(self.root, SOURCE)), "-o", str(library), "-lm"]
        compiled = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603  a compiler
        if compiled.returncode:
            self.app.display_warning(f"{SOURCE} is not compiled, altd runs on numpy: {compiled.stderr}")
            library.unlink(missing_ok=True)
            return
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"
        build_data["artifacts"].append(LIBRARY)
