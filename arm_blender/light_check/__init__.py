"""An asset held against its views under the light that was predicted for them."""
