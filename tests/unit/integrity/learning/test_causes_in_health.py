"""A cause that the judge has named stands in health under its code, once."""

from unittest.mock import Mock

import pytest

from camber.integrity.learning.offset_causes import ISSUE_CODES, Diagnosis
from camber.integrity.service import IntegrityService
from camber.integrity.settings import IntegritySettings
from support.judging import at


@pytest.mark.parametrize(("cause", "code"), ISSUE_CODES.items())
def test_a_named_cause_is_an_issue(cause, code):
    bus = Mock()
    bus.now_ns.return_value = at(0)
    bus.is_alive.return_value = True
    service = IntegrityService(IntegritySettings(), bus)
    service._judge.learning.causes._news.append(Diagnosis(cause=cause, text="-0.40 m up"))
    service.advance(at(0))
    service.advance(at(1))
    bus.issue.assert_called_once_with(code, "-0.40 m up")
