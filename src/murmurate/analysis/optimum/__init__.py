"""The best formations there are: search, polishing, bounds and the table of the best known."""
