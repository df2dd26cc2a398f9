"""One module a section: `make(context)` returns its blocks or raises `NotSupported` with the reason."""
