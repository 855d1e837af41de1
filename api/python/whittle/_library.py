# SPDX-License-Identifier: GPL-3.0-or-later
"""libwhittle by ctypes: its functions with their types, and its errors as exceptions.

The library is looked for where WHITTLE_LIBRARY says, else beside this module's installation, else by the system's
loader.  The declarations are those of whittle.h.
"""
import ctypes
import os
import pathlib
import queue
import threading
from ctypes import POINTER, byref, c_char, c_char_p, c_double, c_float, c_int, c_size_t, c_uint32, c_uint64, c_void_p

SONAME = "libwhittle.so.0"
OK, NO_MEMORY, CANCELLED = 0, 1, 8


class Error(Exception):
    """What the library refused.  status is its name, such as "bad_parameter"; where names the option, the attribute or
    the stage; line (from 1) and byte_offset (from 0) say where in a file, None where that is not known."""

    def __init__(self, status, where, text, line=None, byte_offset=None):
        place = f"line {line}: " if line else f"byte {byte_offset}: " if byte_offset is not None else ""
        super().__init__(f"{where}: {place}{text}" if where else place + text)
        self.status, self.where, self.text, self.line, self.byte_offset = status, where, text, line, byte_offset


class Cancelled(Error):
    """The progress callback answered true."""


class CError(ctypes.Structure):
    _fields_ = [("code", c_int), ("line", c_uint64), ("byte_offset", c_uint64), ("where", c_char * 64),
                ("text", c_char * 320)]


class CAttribute(ctypes.Structure):
    _fields_ = [("name", c_char_p), ("type", c_int), ("values", c_void_p), ("stride_bytes", c_size_t)]


class COption(ctypes.Structure):
    _fields_ = [("name", c_char_p), ("default_text", c_char_p), ("unit", c_char_p), ("help", c_char_p)]


TICK = ctypes.CFUNCTYPE(c_int, c_void_p, c_char_p, c_double)


class CProgress(ctypes.Structure):
    _fields_ = [("tick", TICK), ("context", c_void_p)]


PROTOTYPES = {
    "version": (c_char_p,),
    "status_name": (c_char_p, c_int),
    "cloud_new": (c_int, c_size_t, POINTER(CAttribute), c_size_t, POINTER(c_void_p), POINTER(CError)),
    "cloud_set_triangles": (c_int, c_void_p, c_void_p, c_size_t, POINTER(CError)),
    "cloud_read": (c_int, c_char_p, c_char_p, POINTER(CProgress), POINTER(c_void_p), POINTER(CError)),
    "cloud_read_memory": (c_int, c_char_p, c_size_t, c_char_p, POINTER(CProgress), POINTER(c_void_p), POINTER(CError)),
    "cloud_free": (None, c_void_p),
    "cloud_count": (c_size_t, c_void_p),
    "cloud_attribute_count": (c_size_t, c_void_p),
    "cloud_attribute": (CAttribute, c_void_p, c_size_t),
    "cloud_positions": (c_void_p, c_void_p),
    "cloud_triangles": (c_void_p, c_void_p, POINTER(c_size_t)),
    "options_new": (c_void_p,),
    "options_free": (None, c_void_p),
    "options_set": (c_int, c_void_p, c_char_p, c_char_p, POINTER(CError)),
    "option_at": (c_int, c_size_t, POINTER(COption)),
    "option_allowed": (None, c_size_t, c_char_p, c_size_t),
    "simplify": (c_int, c_void_p, c_void_p, POINTER(CProgress), POINTER(c_void_p), POINTER(CError)),
    "result_free": (None, c_void_p),
    "result_levels": (c_size_t, c_void_p),
    "result_kept": (c_void_p, c_void_p, c_size_t, POINTER(c_size_t)),
    "result_moved": (c_void_p, c_void_p),
    "result_vertices": (c_void_p, c_void_p, c_size_t, POINTER(c_size_t)),
    "result_triangles": (c_void_p, c_void_p, c_size_t, POINTER(c_size_t)),
    "result_sources": (c_void_p, c_void_p, c_size_t),
    "result_normals": (c_void_p, c_void_p),
    "result_operator": (c_void_p, c_void_p),
    "result_distances": (c_void_p, c_void_p),
    "result_number": (c_int, c_void_p, c_size_t, c_char_p, POINTER(c_double)),
    "result_number_name": (c_char_p, c_size_t),
    "result_warning": (c_int, c_void_p, c_size_t, c_size_t, c_char_p, c_size_t),
    "result_left_out": (c_char_p, c_void_p, c_size_t),
}


def _load():
    named = os.environ.get("WHITTLE_LIBRARY")
    here = pathlib.Path(__file__).resolve()
    nearby = [str(folder / SONAME) for folder in (here.parent, here.parents[3]) if (folder / SONAME).exists()]
    for name in [named] if named else nearby + [SONAME]:
        try:
            library = ctypes.CDLL(name)
            break
        except OSError as error:
            reason = error
    else:
        raise ImportError(f"whittle: the library {name} can't be loaded ({reason}); install libwhittle0, or name the "
                          "file in WHITTLE_LIBRARY")
    functions = {}
    for name, (result, *arguments) in PROTOTYPES.items():
        function = getattr(library, "whittle_" + name)
        function.restype, function.argtypes = result, arguments
        functions[name] = function
    return functions


LIBRARY = _load()


def call(name, *arguments):
    """Calls a function that returns a status, with the error as its last argument; raises what it tells."""
    error = CError()
    status = LIBRARY[name](*arguments, byref(error))
    if status == OK:
        return
    if status == NO_MEMORY:
        raise MemoryError(error.text.decode())
    kind = Cancelled if status == CANCELLED else Error
    unknown = 2 ** 64 - 1
    raise kind(LIBRARY["status_name"](status).decode(), error.where.decode(errors="replace"),
               error.text.decode(errors="replace"), error.line or None,
               None if error.byte_offset == unknown else error.byte_offset)


class Handle:
    """A handle of the library, freed with this object."""

    def __init__(self, pointer, free):
        self.pointer, self._free = pointer, LIBRARY[free]

    @property
    def _as_parameter_(self):  # as an argument of the library
        return c_void_p(self.pointer)

    def __del__(self):
        if getattr(self, "pointer", None):
            self._free(self.pointer)
            self.pointer = None


class Running:
    """A call of the library, in a thread of its own, so that this one stays a thread of Python: what the progress
    function or a handler of a signal raises here, KeyboardInterrupt above all, cancels the call and comes out of it."""

    def __init__(self, name, before, after, function):
        self.arguments = (name, *before, byref(CProgress(TICK(self._tick), None)), *after)
        self.function, self.raised, self.stopped = function, None, False
        self.ticks, self.answers = queue.SimpleQueue(), queue.SimpleQueue()
        self.thread = threading.Thread(target=self._run, name="whittle")

    def _run(self):
        try:
            call(*self.arguments)
        except BaseException as error:  # pylint: disable=broad-except
            self.raised = error
        finally:
            self.arguments = None  # or this object and the callback would keep each other, and what they point to
            self.ticks.put(None)

    def _tick(self, _context, stage, fraction):
        if self.function and not self.stopped:
            self.ticks.put((stage.decode(), fraction))
            return self.answers.get()
        return 1 if self.stopped else 0

    def result(self):
        try:
            self.thread.start()
            while tick := self.ticks.get():
                self.answers.put(1 if self.function(*tick) else 0)
        except BaseException:
            self.stopped = True
            self.answers.put(1)
            if self.thread.is_alive():
                self.thread.join()
            self.raised = None
            raise
        self.thread.join()
        try:
            if self.raised:
                raise self.raised
        finally:
            self.raised = None


def call_with_progress(name, before, function, after):
    """call(name, *before, progress, *after), where function (stage, fraction) -> bool may be None.  The arguments live
    until the library has ended, even where a second Ctrl-C ends the wait for it: handles come as objects of Handle."""
    Running(name, before, after, function).result()


def option_text(value):
    """An option's value as the library reads it: True is true, lists and arrays are joined by commas."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (list, tuple)):
        return ",".join(option_text(v) for v in value)
    if isinstance(value, float):
        return repr(value)
    return str(value)


def version():
    """The library's version."""
    return LIBRARY["version"]().decode()


def options():
    """What can be set: a list of dicts with name, default, unit, allowed, help."""
    found, option, allowed = [], COption(), ctypes.create_string_buffer(1024)
    while LIBRARY["option_at"](len(found), byref(option)):
        LIBRARY["option_allowed"](len(found), allowed, len(allowed))
        found.append({"name": option.name.decode(), "default": option.default_text.decode(),
                      "unit": option.unit.decode(), "allowed": allowed.value.decode(), "help": option.help.decode()})
    return found


def array_at(pointer, ctype, shape, owner):
    """A read-only numpy array over memory of the library, which owner keeps alive; None where pointer is NULL."""
    import numpy
    if not pointer:
        return None
    count = 1
    for n in shape:
        count *= n
    buffer = (ctype * count).from_address(pointer)
    buffer.owner = owner
    array = numpy.frombuffer(buffer, dtype=numpy.dtype(ctype)).reshape(shape)
    array.flags.writeable = False
    return array


__all__ = ["CAttribute", "Cancelled", "Error", "Handle", "LIBRARY", "array_at", "byref", "c_double", "c_float",
           "c_size_t", "c_uint32", "c_void_p", "call", "call_with_progress", "option_text", "options", "version"]
