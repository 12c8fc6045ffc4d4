"""Whether Eevee can run: without a window it needs a graphics device that answers, and its lack aborts Blender."""

import ctypes
import sys

import bpy

from ..errors import ArmError

_OPENGL_BIT, _RENDERABLE_TYPE, _NONE = 0x0008, 0x3040, 0x3038
"""Of EGL 1.4: desktop OpenGL, the attribute that asks for it, the end of a list."""


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
    """Whether EGL has a display that draws desktop OpenGL: what Blender will ask it for."""
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError:
        return False
    egl.eglGetDisplay.restype = ctypes.c_void_p
    egl.eglGetDisplay.argtypes = [ctypes.c_void_p]
    egl.eglInitialize.argtypes = [ctypes.c_void_p] * 3
    egl.eglChooseConfig.argtypes = [ctypes.c_void_p] * 3 + [ctypes.c_int, ctypes.c_void_p]
    display = egl.eglGetDisplay(None)
    if not display or not egl.eglInitialize(display, None, None):
        return False
    wish = (ctypes.c_int * 3)(_RENDERABLE_TYPE, _OPENGL_BIT, _NONE)
    count = ctypes.c_int(0)
    # Not terminated afterwards: the display is one for the whole process, and Blender may be using it.
    return bool(egl.eglChooseConfig(display, wish, None, 0, ctypes.byref(count))) and count.value > 0
