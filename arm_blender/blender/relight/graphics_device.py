"""Whether Eevee can run: without a window it needs a graphics device that answers, and its lack aborts Blender."""

import ctypes
import sys

import bpy

from ...errors import ArmError

_SURFACELESS = 0x31DD
"""EGL_PLATFORM_SURFACELESS_MESA: drawing without any window system."""


def check_eevee() -> None:
    """Makes sure that Eevee finds a graphics device, real or software.

    Raises:
        ArmError: there is none.
    """
    if bpy.app.background and sys.platform.startswith("linux") and not _egl_answers():
        raise ArmError(
            "Eevee needs a graphics device, and without a window finds none here (EGL); use Cycles, or install one: "
            "libegl1 and libgl1-mesa-dri need no hardware"
        )


def _egl_answers() -> bool:
    """Whether EGL has a display that can be opened: that of a window system, or one without any."""
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError:
        return False
    egl.eglGetDisplay.restype = egl.eglGetPlatformDisplay.restype = ctypes.c_void_p
    egl.eglGetDisplay.argtypes = [ctypes.c_void_p]
    egl.eglGetPlatformDisplay.argtypes = [ctypes.c_uint, ctypes.c_void_p, ctypes.c_void_p]
    egl.eglInitialize.argtypes = [ctypes.c_void_p] * 3
    # Not closed afterwards: a display is one for the whole process, and Blender may be using it.
    displays = (egl.eglGetDisplay(None), egl.eglGetPlatformDisplay(_SURFACELESS, None, None))
    return any(display and egl.eglInitialize(display, None, None) for display in displays)
