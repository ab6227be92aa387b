import numpy as np
import pytest

from bgn.policies.alpha_file import PolicyFormatError, load, save
from bgn.policies.alpha_vectors import AlphaVectors
from tests.planning.models import best_action

DENSE = """<?xml version="1.0" encoding="ISO-8859-1"?>
<Policy version="0.1" type="value" model="x.pomdpx"
 xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="policyx.xsd">
<AlphaVector vectorLength="2" numObsValue="3" numVectors="3">
<Vector action="1" obsValue="0">9.5 -2 </Vector>
<SparseVector action="3" obsValue="2"><Entry>1 0.5</Entry></SparseVector>
<Vector action="2" obsValue="1">1e1 18.0737 </Vector>
</AlphaVector> </Policy>
"""


def test_what_is_saved_loads_alike(tmp_path):
    random = np.random.default_rng(0)
    policy = AlphaVectors(vectors=random.normal(size=(5, 7)), actions=np.array([0, 3, 1, 1, 2]))
    path = tmp_path / "a.policy"
    save(policy, path, model="a.pomdp")
    again = load(path)
    assert (again.vectors == policy.vectors).all()
    assert (again.actions == policy.actions).all()
    text = path.read_text()
    assert 'vectorLength="7" numObsValue="1" numVectors="5"' in text
    assert 'type="value" model="a.pomdp" xsi:noNamespaceSchemaLocation="policyx.xsd"' in text


def test_vectors_of_an_observed_part_and_sparse_ones(tmp_path):
    path = tmp_path / "b.policyx"
    path.write_text(DENSE)
    policy = load(path)
    assert policy.actions.tolist() == [1, 3, 2]
    assert policy.vectors.tolist() == [
        [9.5, -2, -3, -3, -3, -3],
        [-3, -3, -3, -3, 0, 0.5],
        [-3, -3, 10, 18.0737, -3, -3],
    ]
    assert best_action(policy, np.array([0, 0, 0.5, 0.5, 0, 0])) == 2
    assert (
        best_action(policy, np.array([0, 1, 0, 0, 0, 0])) == 1
    )  # though the others' entries are not far below


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("</Policy>", ""), "not XML"),
        (("Policy", "Politics"), "expected <Policy>"),
        (('vectorLength="2"', ""), "needs vectorLength as a positive number, found ''"),
        (('numVectors="3"', 'numVectors="4"'), "numVectors is 4, but there are 3"),
        (("9.5 -2", "9.5"), "vector 0 needs 2 finite numbers, found 1"),
        (("9.5 -2", "9.5 nan"), "vector 0 needs 2 finite numbers"),
        (("9.5 -2", "9.5 x"), "vector 0: could not convert"),
        (("<Entry>1 0.5", "<Entry>4 0.5"), "vector 1: index 4"),
        (('obsValue="2"', 'obsValue="3"'), "vector 1 needs obsValue as a number below 3, found '3'"),
        (('action="2"', 'action="up"'), "vector 2 needs action as a number, found 'up'"),
    ],
)
def test_a_bad_file_is_named_with_what_is_wrong(tmp_path, change, message):
    path = tmp_path / "bad.policy"
    path.write_text(DENSE.replace(*change))
    with pytest.raises(PolicyFormatError, match=message) as raised:
        load(path)
    assert "bad.policy" in str(raised.value)
