"""How the quantities of a result are reported: declared where its dataclass is, and rendered from that."""
