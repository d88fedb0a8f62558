"""The native core, loaded in the build for the best instruction set of this processor (see ``loading``)."""

from supple._core.loading import load as _load

_module = _load()
isa = _module.__name__.rpartition(".")[2]
globals().update({name: value for name, value in vars(_module).items() if not name.startswith("_")})
