"""A Grafana dashboard of the figures that `fovea metrics` serves."""

from typing import Any

WIDTH, HEIGHT, COLUMNS = 12, 8, 2  # of a panel, in cells of Grafana's grid; panels in a row
OF = '{graph=~"$graph"}'
P99 = '{graph=~"$graph",percentile="99"}'
PANELS = (  # title, unit, expression, legend
    (
        "Frames handled a second", "ops",
        f"rate(fovea_node_messages_handled_total{OF}[1m])", "{{node}}",
    ),
    ("Loop: picture to command", "s", f"fovea_loop_seconds{OF}", "{{node}} p{{percentile}}"),
    ("Handler, p99", "s", f"fovea_node_handler_seconds{P99}", "{{node}}"),
    ("Age of messages when used, p99", "s", f"fovea_edge_age_seconds{P99}", "{{from}} to {{to}}"),
    (
        "Messages dropped a second", "ops",
        f"rate(fovea_edge_messages_dropped_total{OF}[1m])", "{{from}} to {{to}}: {{reason}}",
    ),
    ("Messages in flight", "short", f"fovea_edge_in_flight{OF}", "{{from}} to {{to}}"),
    ("Cores", "short", f"rate(fovea_process_cpu_seconds_total{OF}[1m])", "{{process}}"),
    ("Memory", "bytes", f"fovea_process_resident_memory_bytes{OF}", "{{process}}"),
    ("Restarts and crashes", "short", f"fovea_process_restarts_total{OF}", "{{process}} restarts"),
    ("Instances: swaps and restarts", "short", f"fovea_node_instance{OF}", "{{node}}"),
)  # fmt: skip


def dashboard() -> dict[str, Any]:
    """Return the dashboard, to be imported into Grafana; it asks for its data source."""
    source = {"type": "prometheus", "uid": "${source}"}
    panels = [
        {
            "id": number + 1,
            "type": "timeseries",
            "title": title,
            "datasource": source,
            "gridPos": {
                "x": number % COLUMNS * WIDTH, "y": number // COLUMNS * HEIGHT,
                "w": WIDTH, "h": HEIGHT,
            },
            "fieldConfig": {"defaults": {"unit": unit, "min": 0}, "overrides": []},
            "targets": [
                {"refId": "A", "expr": query, "legendFormat": legend, "datasource": source}
            ],
        }
        for number, (title, unit, query, legend) in enumerate(PANELS)
    ]  # fmt: skip
    chosen = {
        "name": "graph", "type": "query", "datasource": source, "multi": True, "includeAll": True,
        "query": "label_values(fovea_graph_running, graph)", "refresh": 2,
        "current": {"text": "All", "value": "$__all"},
    }  # fmt: skip
    return {
        "title": "fovea",
        "uid": "fovea",
        "schemaVersion": 39,
        "version": 1,
        "editable": True,
        "refresh": "5s",
        "time": {"from": "now-15m", "to": "now"},
        "templating": {
            "list": [{"name": "source", "type": "datasource", "query": "prometheus"}, chosen]
        },
        "panels": panels,
    }
