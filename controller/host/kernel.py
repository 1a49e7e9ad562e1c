"""The door to numba for all kernels: their signatures are declared, and their machine code is loaded at the first call.

A process calls few of the kernels that it imports. Each that is loaded takes milliseconds and a megabyte, and each that
has no machine code in the cache is compiled, which takes seconds.
"""

import sys
from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import config
from numba.core.compiler import DEFAULT_FLAGS
from numba.core.compiler_lock import global_compiler_lock
from numba.core.event import Event, Listener, register
from numba.core.registry import CPUDispatcher
from numba.core.targetconfig import ConfigStack

F = TypeVar("F", bound=Callable[..., Any])
kernels = list["Kernel"]()  # of all modules that this process has imported


class Kernel(CPUDispatcher):
    """A compiled function with declared signatures; a call with other types raises TypeError."""

    declared: tuple[Any, ...] = ()  # signatures, until all are loaded
    loading = False

    def load(self) -> None:
        """Loads the machine code of all signatures, or compiles it. Another thread waits until this is done."""
        with global_compiler_lock:
            if not self.declared or self.loading:
                return
            self.loading = True
            try:
                # Otherwise a kernel that calls this one would pass on its option _nrt.
                with ConfigStack().enter(DEFAULT_FLAGS.copy()):  # type: ignore[no-untyped-call]
                    for signature in self.declared:
                        self.compile(signature)
                self.disable_compile()
                self.declared = ()
            finally:
                self.loading = False

    def _compile_for_args(self, *args: Any, **kws: Any) -> Any:
        """Is called by numba if no loaded signature fits a call. Returns what numba calls then."""
        if not self.declared:
            return super()._compile_for_args(*args, **kws)  # type: ignore[misc]
        self.load()
        return self

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Is called by numba while it compiles a kernel that calls this one."""
        self.load()
        return super().get_call_template(args, kws)


def load(function: Callable[..., Any]) -> None:
    """Loads a kernel before its first call."""
    if isinstance(function, Kernel):
        function.load()


class Progress(Listener):
    """Says at the first kernel without machine code why the call takes long, and counts the kernels on a terminal."""

    count = 0
    silent = False

    def on_start(self, event: Event) -> None:
        if self.silent or not isinstance(event.data["dispatcher"], Kernel):
            return
        self.count += 1
        if self.count == 1:
            sys.stderr.write("kernels are compiled at their first call, which takes up to minutes, and are kept then\n")
        if sys.stderr.isatty():
            sys.stderr.write(f"\r{self.count} kernels compiled ")

    def on_end(self, event: Event) -> None:
        """Does nothing; numba calls it."""


progress = Progress()
register("numba:compile", progress)  # type: ignore[no-untyped-call]


def kernel(signatures: Any, **options: Any) -> Callable[[F], F]:
    """Returns a decorator that makes a Kernel of a function.

    Args:
        signatures: a signature, or a list of them, as for numba's `njit`.
        options: options of `njit`, beside those that all kernels have: machine code is cached, and the kernel releases
            the interpreter's lock.

    With NUMBA_DISABLE_JIT the function stays as it is.
    """
    declared = tuple(signatures) if isinstance(signatures, list) else (signatures,)

    def decorate(function: F) -> F:
        if config.DISABLE_JIT:  # type: ignore[attr-defined]
            return function
        made = Kernel(function, targetoptions={"nopython": True, "boundscheck": None, "nogil": True, **options})
        made.enable_caching()
        made.declared = declared
        kernels.append(made)
        return cast(F, made)

    return decorate
