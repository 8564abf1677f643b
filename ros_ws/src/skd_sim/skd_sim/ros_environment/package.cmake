# The CMakeLists.txt of each package of messages below.
get_filename_component(name ${CMAKE_CURRENT_SOURCE_DIR} NAME)
project(${name} NONE)
file(GLOB messages RELATIVE ${CMAKE_CURRENT_SOURCE_DIR} msg/*.msg)
rosidl_generate_interfaces(${PROJECT_NAME} ${messages} DEPENDENCIES ${SKD_DEPENDENCIES_OF_${name}})
ament_package()
