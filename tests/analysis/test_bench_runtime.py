"""The benchmark of the robot's runtime."""

from analysis.bench import runtime


def test_rows(monkeypatch):
    for name, value in (("STARTS", 3), ("SESSIONS", 4), ("LONG", 50), ("DRAWS", 10)):
        monkeypatch.setattr(runtime, name, value)
    said = []
    rows = {row.name: row for row in runtime.run(quick=True, progress=said.append)}
    assert said[:2] == ["policies", "cold starts"]
    assert len(rows) == 1 + 2 * 5 + 2
    assert rows["import and first decision, fresh process"].target == "< 0.5 s"
    for name in ("alpha vectors", "exact plan", "10 draws", "10 draws, two safeguards"):
        median, high = (rows[f"a decision in the log, {which}: {name}"] for which in ("median", "99th percentile"))
        assert 0 < median.ours <= high.ours
        assert median.ours < 1000
        assert high.target == "< 1000 us"
        assert "35 decisions" in median.note
    assert rows["checking a log of 10 events"].ours > 0
