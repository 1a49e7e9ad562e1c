"""All parts but drivers. Each import of it watches for numba, whose files may be damaged or cannot be written."""

from hyperbit.controller.host.machine_code import watch

watch()
