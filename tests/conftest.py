import gc


def pytest_collection_finish():
    """Leave what was imported out of all later garbage collections: a fifth of the time of small runs."""
    gc.collect()
    gc.freeze()
