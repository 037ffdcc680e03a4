"""`jaxdr view`: results as one web page that needs no network (docs/view.md)."""
