"""Imports all of hyperbit, so that its kernels are compiled and kept."""

import importlib
import pkgutil

import hyperbit.controller
import hyperbit.drivers

for package in (hyperbit.controller, hyperbit.drivers):
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        imported = importlib.import_module(module.name)
        for variant in getattr(imported, "KERNEL_VARIANTS", ()):
            imported.kernel(*variant)
