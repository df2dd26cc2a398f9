"""Safeguards around any policy: bounded cost, least influence, confidence, consent, reasons, an audit log."""
