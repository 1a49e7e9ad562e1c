"""Names, keys, tokens, quality of service and attachments, without a network."""

import contextlib

import pytest
import xxhash
import zenoh.ext
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.ros2.wire import attachments, names, qos, tokens
from hyperbit.controller.ros2.wire.attachments import Attachment, BadAttachment
from hyperbit.controller.ros2.wire.names import BadName
from hyperbit.controller.ros2.wire.qos import Qos
from hyperbit.controller.ros2.wire.tokens import BadToken, EndpointToken, Kind, Token

part = st.from_regex(r"[A-Za-z][A-Za-z0-9]{0,8}(_[a-z0-9]{1,4})?", fullmatch=True)
absolute = st.lists(part, min_size=1, max_size=4).map(lambda parts: "/" + "/".join(parts))
namespace = st.one_of(st.just("/"), absolute)
numbers = st.integers(0, 10**9).map(str)
timing = st.tuples(*[st.one_of(st.just(""), numbers)] * 7).map(lambda n: "{},{}:{},{}:{},{},{}".format(*n))
settings = st.tuples(*[st.sampled_from(["", "1", "2"])] * 3, numbers, timing).map(
    lambda it: "{}:{}:{},{}:{}".format(*it)
)
endpoints = st.builds(
    EndpointToken, absolute, st.just("std_msgs::msg::dds_::String_"), st.just("RIHS01_" + "a" * 64), settings
)
node_tokens = st.builds(
    Token, st.integers(0, 232), st.from_regex(r"[1-9a-f][0-9a-f]{0,31}", fullmatch=True), numbers, numbers,
    st.just(Kind.NODE), part, namespace, namespace, st.none(),
)  # fmt: skip
endpoint_tokens = st.builds(
    lambda token, kind, endpoint: token._replace(kind=kind, endpoint=endpoint),
    node_tokens,
    st.sampled_from([kind for kind in Kind if kind is not Kind.NODE]),
    endpoints,
)


@given(absolute)
def test_mangling_is_reversible(name: str) -> None:
    assert "/" not in names.mangle(name)
    assert names.demangle(names.mangle(name)) == name


@pytest.mark.parametrize(
    ("name", "namespace", "expected"),
    [
        ("/tf", "/arm/left", "/tf"),
        ("goal", "/arm/left", "/arm/left/goal"),
        ("~/goal", "/arm/left", "/arm/left/bridge/goal"),
        ("a/_action", "/arm/left", "/arm/left/a/_action"),
        ("goal", "/", "/goal"),
        ("~/goal", "/", "/bridge/goal"),
    ],
)
def test_names_are_resolved(name: str, namespace: str, expected: str) -> None:
    assert names.resolve(name, namespace, "bridge") == expected


@pytest.mark.parametrize(
    "name", ["", "/", "a/", "//a", "a//b", "1a", "a__b", "a b", "ä", "a\n", "~", "~a", "a/**", "a" * 256]
)
def test_other_names_are_refused(name: str) -> None:
    with pytest.raises(BadName, match="is no name of a topic"):
        names.resolve(name, "/", "node")


@pytest.mark.parametrize(
    ("name", "namespace"), [("a/b", "/"), ("", "/"), ("a-b", "/"), ("a", ""), ("a", "b"), ("a", "/b/")]
)
def test_other_nodes_are_refused(name: str, namespace: str) -> None:
    with pytest.raises(BadName):
        names.check_node(name, namespace)


def test_the_key_of_a_topic_is_that_of_rmw_zenoh() -> None:
    type_hash = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    key = names.data_key(0, "/arm/chatter", "std_msgs/msg/String", type_hash)
    assert key == f"0/arm/chatter/std_msgs::msg::dds_::String_/{type_hash}"


@pytest.mark.parametrize("name", ["String", "std_msgs/String", "std_msgs/msg/", "std_msgs/foo/String", "a/msg/b/C"])
def test_other_types_are_refused(name: str) -> None:
    with pytest.raises(BadName, match="is no type"):
        names.dds_type(name)


@pytest.mark.parametrize(
    ("setting", "text"),
    [
        (qos.DEFAULT, "::,10:,:,:,,"),
        (qos.LATCHED, ":1:,1:,:,:,,"),
        (qos.TF, "::,100:,:,:,,"),
        (qos.SENSOR_DATA, "2::,5:,:,:,,"),
        (Qos(latched=True, depth=42), ":1:,:,:,:,,"),
    ],
)
def test_presets_are_written_as_rmw_zenoh_writes_them(setting: Qos, text: str) -> None:
    assert setting.text == text


@given(st.one_of(node_tokens, endpoint_tokens))
def test_a_token_is_reversible(token: Token) -> None:
    assert tokens.parse(token.text) == token
    assert len(token.text.split("/")) == (9 if token.kind is Kind.NODE else 13)


@given(st.one_of(st.text(), st.lists(st.text(max_size=4), max_size=14).map(lambda it: "@ros2_lv/" + "/".join(it))))
def test_any_key_is_a_token_or_refused(text: str) -> None:
    with contextlib.suppress(BadToken):
        assert tokens.parse(text).text.startswith("@ros2_lv/")


def test_the_gid_of_a_node_is_the_low_half_of_its_tokens_hash_then_the_high_half() -> None:
    """XXH3-128 of nothing has the low half 6001c324468d497f and the high half 99aa06d3014798d8, by xxHash's tests."""
    assert xxhash.xxh3_128_intdigest(b"") == 0x99AA06D3014798D86001C324468D497F
    token = Token(0, "a1", "0", "0", Kind.NODE, "talker")
    assert token.text == "@ros2_lv/0/a1/0/0/NN/%/%/talker"
    high, low = divmod(xxhash.xxh3_128_intdigest(token.text.encode()), 2**64)
    assert token.gid == low.to_bytes(8, "little") + high.to_bytes(8, "little")


@given(st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_an_attachment_is_what_zenoh_serializes_and_is_reversible(sequence: int, source_time: int, gid: bytes) -> None:
    """rmw_zenoh writes attachments by Zenoh's serializer: two numbers, and 16 bytes behind their length."""
    whole = zenoh.ext.z_serialize((zenoh.ext.Int64(sequence), zenoh.ext.Int64(source_time), gid))
    attachment = Attachment(sequence, source_time, gid)
    assert attachment.data == whole.to_bytes()
    assert attachments.parse(attachment.data) == attachment


@given(st.binary(max_size=80))
def test_any_bytes_are_an_attachment_or_refused(data: bytes) -> None:
    try:
        assert attachments.parse(data).data == data
    except BadAttachment:
        assert len(data) != 33 or data[16] != 16 or data[7] > 127 or data[15] > 127


def test_no_attachment_is_refused() -> None:
    with pytest.raises(BadAttachment, match="this one has none"):
        attachments.parse(None)
