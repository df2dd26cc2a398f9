"""What the world is and how to act in it: protocol, event histories, latent-state models and their learning.

Arrays in, arrays out. Nothing here knows a data registry, a plot or a command line, and
importing this package imports nothing heavy: take what you need from its modules.
"""

import time

IMPORTED = time.time()
"""When a process first imported this package: files changed later may not be the code that runs."""
