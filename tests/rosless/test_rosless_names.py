"""Names of nodes and topics."""

from __future__ import annotations

import pytest
from rosless.exceptions import InvalidNamespaceException, InvalidNodeNameException, InvalidTopicNameException

from rosless import names


@pytest.mark.parametrize("name", ["chatter", "/a/b_c", "~", "~/x", "a1", "_hidden", "{node}/x", "/a/{ns}/b"])
def test_valid_topics(name: str) -> None:
    assert names.validate_topic_name(name)


@pytest.mark.parametrize("name", ["", "/", "a/", "a//b", "1a", "a/1b", "a b", "a-b", "~a", "a~", "ä"])
def test_invalid_topics(name: str) -> None:
    with pytest.raises(InvalidTopicNameException):
        names.validate_topic_name(name)


def test_full_topics_are_absolute() -> None:
    assert names.validate_full_topic_name("/a/b")
    for name in ("a", "~/a", "/{node}"):
        with pytest.raises(InvalidTopicNameException):
            names.validate_full_topic_name(name)


@pytest.mark.parametrize("name", ["", "a/b", "1a", "a b", "a-b"])
def test_invalid_node_names(name: str) -> None:
    with pytest.raises(InvalidNodeNameException):
        names.validate_node_name(name)


@pytest.mark.parametrize("name", ["", "a", "/a/", "//a", "/1", "/a b"])
def test_invalid_namespaces(name: str) -> None:
    with pytest.raises(InvalidNamespaceException):
        names.validate_namespace(name)


@pytest.mark.parametrize(
    ("topic", "expanded"),
    [
        ("a", "/ns/a"),
        ("/a", "/a"),
        ("~", "/ns/n"),
        ("~/a/b", "/ns/n/a/b"),
        ("{node}/x", "/ns/n/x"),
        ("{ns}/x", "/ns/x"),
    ],
)
def test_expansion(topic: str, expanded: str) -> None:
    assert names.expand_topic_name(topic, "n", "/ns") == expanded


def test_expansion_in_the_root_namespace() -> None:
    assert names.expand_topic_name("a", "n", "/") == "/a"
    assert names.expand_topic_name("~/a", "n", "/") == "/n/a"


def test_the_message_points_at_the_character() -> None:
    with pytest.raises(InvalidTopicNameException) as caught:
        names.validate_topic_name("ab?c")
    assert str(caught.value).splitlines()[-1].index("^") == 3 + 2
