"""Other nodes of the graph: discovery, servers, and identities of clients."""
