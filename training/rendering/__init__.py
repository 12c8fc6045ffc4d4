"""Objects to shards: Cycles renders views and passes, shards keep them."""
