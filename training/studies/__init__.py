"""What makes the documents: each command measures one thing and writes its page."""
