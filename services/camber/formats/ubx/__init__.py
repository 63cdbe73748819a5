"""UBX messages of u-blox receivers, read and written."""
