"""UBX messages of u-blox receivers, decoded and encoded."""
