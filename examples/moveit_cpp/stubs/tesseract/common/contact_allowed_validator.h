// Stand-in for Tesseract's header of this name.
#pragma once

#include <tesseract/collision/types.h>

namespace tesseract::common {
class ContactAllowedValidator {
public:
    virtual ~ContactAllowedValidator() = default;
    virtual bool operator()(const LinkIdPair &pair) const = 0;
};
} // namespace tesseract::common
