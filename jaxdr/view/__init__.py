"""Results as one web page that needs no network: `jaxdr view` (docs/view.md)."""
