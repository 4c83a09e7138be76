"""Live data over the network: a page with its metrics, and a Foxglove WebSocket. README.md explains both."""
