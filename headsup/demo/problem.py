"""What can go wrong in a demo, said in one line."""


class DemoError(RuntimeError):
    """The demo cannot go on; the message says why and what to do."""
