"""Other programs on the same data, side by side.

``strogatz`` (``strogatz_files``) is the race on the 14 label files: ``strogatz_versus`` against ``operon``,
``strogatz_noise`` by the rules of ``srbench`` (``simplification``); ``pysindy_models`` is compared on noisy data
and on random systems, ``operon_models`` on the latter.
"""
