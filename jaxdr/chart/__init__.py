"""`jaxdr chart`: speed against accuracy of estimators of derivatives, measured against references (docs/chart.md)."""
