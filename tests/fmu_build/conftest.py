import pytest


@pytest.fixture(autouse=True, scope="session")
def cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HALFSHAFT_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield
