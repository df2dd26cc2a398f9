"""Files from strangers: every reader gets damaged ones, and may answer with a result or an `InputError` only."""
