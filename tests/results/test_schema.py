from __future__ import annotations

import datetime

import pandas as pd
import pytest

from bgn.results import schema
from bgn.results.schema import SchemaError


def values(**changes: object) -> dict[str, object]:
    columns = {**schema.RUN_IDENTITY, **schema.OUTCOME, **schema.PROVENANCE}
    now = datetime.datetime.now(datetime.UTC)
    filled = dict.fromkeys(columns, None)
    return filled | {"run": "a/b/seed-0", "seed": 0, "stack_seeds": [0, 1], "started_at": now} | changes


def test_row_keeps_types_and_metrics() -> None:
    table = schema.row(schema.RUN_IDENTITY, values(), {"train_return": 1})
    frame = table.to_pandas()
    assert frame["train_return"].dtype == "float64"
    assert list(frame["stack_seeds"][0]) == [0, 1]
    assert frame["started_at"][0].tzinfo is not None


def test_row_refuses_missing_and_unknown_columns() -> None:
    with pytest.raises(SchemaError, match="surprise"):
        schema.row(schema.RUN_IDENTITY, values(surprise=1), {})
    incomplete = values()
    del incomplete["device"]
    with pytest.raises(SchemaError, match="device"):
        schema.row(schema.RUN_IDENTITY, incomplete, {})


def test_row_refuses_wrong_types() -> None:
    with pytest.raises(SchemaError, match="a/b/seed-0"):
        schema.row(schema.RUN_IDENTITY, values(seed="three"), {})


def test_missing_metrics_are_named() -> None:
    with pytest.raises(SchemaError, match="greedy_return"):
        schema.check_metrics("r", dict.fromkeys(schema.RUN_METRICS[:2], 0.0), schema.RUN_METRICS)


def test_curve_says_whose_it_is() -> None:
    columns = [*schema.CURVE_COLUMNS, "a_loss"]
    curve = pd.DataFrame({name: [0.0, 1.0] for name in columns})
    table = schema.curve_table("r", "k", curve)
    assert table.column_names == ["run", "key", *columns]
    assert set(table["run"].to_pylist()) == {"r"}
    with pytest.raises(SchemaError, match="episodes"):
        schema.curve_table("r", "k", curve.drop(columns="episodes"))
