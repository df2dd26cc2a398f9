"""Schedules so small that every plan can be looked at."""

from tests.models.planning.schedule_cases import schedules
from tests.reference.all_plans import count_plans

MOST = 600


def few_plans(max_draws=4):
    """Random schedules of up to three events with few plans."""
    return schedules(max_events=3, max_draws=max_draws).filter(lambda s: count_plans(s) <= MOST)
