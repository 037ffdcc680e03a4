"""What to render a scene and its derivatives with, measured and explained (docs/plan.md)."""
