"""Speed against peers: each row ours, peer and their ratio, measured in one run of one process."""
