"""The core as plain functions (`core`), the values that they take, and frames that stream through them."""
