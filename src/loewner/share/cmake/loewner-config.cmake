# The target loewner::loewner, for C and C++: in a wheel, or in lib/cmake/loewner below a prefix.
get_filename_component(_loewner_here "${CMAKE_CURRENT_LIST_DIR}" ABSOLUTE)
if(EXISTS "${_loewner_here}/../../_native")
  set(_loewner_include "${_loewner_here}/../../include")
  set(_loewner_library "${_loewner_here}/../../_native/libloewner.so")
else()
  set(_loewner_include "${_loewner_here}/../../../include")
  set(_loewner_library "${_loewner_here}/../../libloewner.so")
endif()
get_filename_component(_loewner_include "${_loewner_include}" ABSOLUTE)
get_filename_component(_loewner_library "${_loewner_library}" ABSOLUTE)
if(NOT EXISTS "${_loewner_library}")
  set(loewner_FOUND FALSE)
  set(loewner_NOT_FOUND_MESSAGE "expected ${_loewner_library}, found none: loewner was installed without its native library")
elseif(NOT TARGET loewner::loewner)
  add_library(loewner::loewner SHARED IMPORTED)
  set_target_properties(loewner::loewner PROPERTIES
    IMPORTED_LOCATION "${_loewner_library}"
    INTERFACE_INCLUDE_DIRECTORIES "${_loewner_include}"
    INTERFACE_COMPILE_FEATURES "c_std_11;cxx_std_17")
endif()
unset(_loewner_here)
unset(_loewner_include)
unset(_loewner_library)
