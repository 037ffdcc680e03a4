"""Speed against accuracy of derivatives: `jaxdr chart` measures estimators against references (docs/chart.md)."""
