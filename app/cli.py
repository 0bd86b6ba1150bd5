"""The command line: each module of `commands` is a command.

What a user did wrong ends with exit code 2 and one message on standard error that names everything that is wrong.
Results go to standard output, warnings and progress to standard error.
"""

from importlib import import_module
from pkgutil import iter_modules

from halfshaft.app import commands
from halfshaft.app.program import app

__all__ = ["app"]

for _found in iter_modules(commands.__path__):
    import_module(f"{commands.__name__}.{_found.name}")


if __name__ == "__main__":
    app()
