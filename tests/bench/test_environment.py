import json

from tdgbench.bench.environment import code_version, describe_environment


def test_describes_the_machine():
    described = describe_environment()
    json.dumps(described)
    assert described["packages"]["numpy"] and described["cpu"] and described["cores"] >= 1
    assert described["simd_lanes"] in (8, 16)


def test_code_version_is_stable():
    assert code_version() == code_version() and len(code_version()) == 16
