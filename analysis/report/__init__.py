"""The report: sections in one ordered list, each a function from a context to tables, figures and sentences."""
