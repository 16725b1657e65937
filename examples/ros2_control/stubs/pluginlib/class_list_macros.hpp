// Stand-in for pluginlib's header of this name: a test makes the only class with `exported()`.
#pragma once

#define PLUGINLIB_EXPORT_CLASS(class_, base_)                                                                          \
    std::unique_ptr<base_> exported()                                                                                  \
    {                                                                                                                  \
        return std::make_unique<class_>();                                                                             \
    }
