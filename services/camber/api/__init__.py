"""What `import camber` offers: a few functions and classes over the services' own code, and nothing that they lack.

Mathematics does not belong here, nor does anything that a service or another tool needs.
"""
