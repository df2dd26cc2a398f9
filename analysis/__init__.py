"""What we ask of the model: data, studies, comparisons, reports, the command line."""
