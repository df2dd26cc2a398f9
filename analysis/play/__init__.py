"""The token game as people play it in a browser: server, sessions, log, page."""
